//===- MemoryVectors.h - Chooses vectors for memory -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_SCALARIZE_MEMORYVECTORS_H
#define TAI_LIB_TRANSFORMS_SCALARIZE_MEMORYVECTORS_H

#include "mlir/IR/Dominance.h"
#include "mlir/IR/Value.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "llvm/ADT/EquivalenceClasses.h"
#include <optional>

namespace mlir::tai {

/// True if the op is a loop or branch of the scf dialect.
bool isControlFlow(Operation *op);

/// Returns the innermost op around the given op or value that is no control
/// flow.
Operation *getScope(Operation *op);
Operation *getScope(Value value);

/// True if the op reads, or writes, one component of a vector, whose position
/// is given in full.
bool isComponentRead(Operation *op);
bool isComponentWrite(Operation *op);
/// True if the op reads or writes one component of a vector at a position that
/// is computed at run time.
bool isAtRunTime(Operation *op);

/// The vectors of a function that are kept in memory, because components are
/// accessed at positions computed at run time.
class MemoryVectors {
public:
  /// Chooses the vectors that are kept in memory; with `withCopies`, also
  /// vectors that must be copied for this.
  MemoryVectors(FunctionOpInterface function, bool withCopies);

  bool empty() const { return chosen.empty(); }
  bool needCopies() const { return accesses > 0; }
  bool contains(Value value) const { return chosen.contains(value); }
  /// Returns the number of the buffer that a vector shares with others.
  std::optional<unsigned> getBuffer(Value value) const {
    auto found = chosen.find(value);
    return found == chosen.end() ? std::nullopt : found->second;
  }

private:
  void join(Value a, Value b) {
    if (isa<VectorType>(a.getType()))
      classes.unionSets(a, b);
  }
  template <typename... Ranges> void joinAll(Ranges... ranges) {
    for (auto values : llvm::zip_equal(ranges...))
      std::apply(
          [&](Value first, auto... others) { (join(first, others), ...); },
          values);
  }
  void joinValuesOf(Operation *op);
  void choose(ArrayRef<Value> members, DominanceInfo &dominance);

  llvm::EquivalenceClasses<Value> classes;
  llvm::DenseMap<Value, std::optional<unsigned>> chosen;
  bool withCopies;
  unsigned numBuffers = 0;
  int64_t bytes = 0, pairs = 0;
  /// The number of accesses of the function to vectors that need copies.
  int64_t accesses = 0;
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_SCALARIZE_MEMORYVECTORS_H
