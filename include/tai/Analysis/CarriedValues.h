//===- CarriedValues.h - Loop-carried values, in reverse --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Two questions about the values that `scf.for` and `scf.while` carry: how the
// value that an iteration begins with can be had again when the iterations run
// backwards, and which of them anything needs.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_CARRIEDVALUES_H
#define TAI_ANALYSIS_CARRIEDVALUES_H

#include "mlir/IR/Operation.h"
#include "llvm/ADT/DenseSet.h"

namespace mlir::tai {

/// How the value that an iteration begins with can be had, when iterations run
/// backwards.
enum class CarriedKind {
  /// It is a formula of the number of the iteration.
  ClosedForm,
  /// The value that the next iteration began with gives it back, exactly.
  Invertible,
  /// It must be remembered, or computed forward once more.
  Trajectory,
};

/// One step from a carried value to the next: `op` is applied to the value as
/// its operand number `operand`.
struct CarriedStep {
  Operation *op;
  unsigned operand;
};

struct CarriedValue {
  CarriedKind kind = CarriedKind::Trajectory;
  /// The steps from this value to the next value of the carried value number
  /// `source`, in the order in which they run. Empty for trajectories.
  llvm::SmallVector<CarriedStep> steps;
  unsigned source = 0;
};

/// The values that a serial loop carries: `scf.for`, or `scf.while`, where the
/// arguments of the first region count.
class CarriedValues {
public:
  explicit CarriedValues(Operation *loop);

  const CarriedValue &operator[](unsigned index) const { return values[index]; }
  size_t size() const { return values.size(); }

  /// The number of the carried value that `value` is, with a name for it in any
  /// region of the loop; none if it is no carried value.
  std::optional<unsigned> getIndex(Value value) const;

private:
  bool isInvariant(Value value) const;
  bool isComputable(Value value, ArrayRef<bool> known, unsigned budget) const;
  void findClosedForm(unsigned index);
  bool invert(unsigned source, ArrayRef<bool> known);
  Value getNext(unsigned index) const;

  Operation *loop;
  llvm::SmallVector<CarriedValue, 4> values;
};

llvm::StringRef stringifyCarriedKind(CarriedKind kind);

/// The values in a region that effects, terminators of the region's own blocks,
/// or given values need. Knows one result of a branch or loop from the next.
class LiveValues {
public:
  explicit LiveValues(Region &region);

  bool isLive(Value value) const { return live.contains(value); }

private:
  void mark(Value value);
  void markOperands(Operation *op);
  void markControl(Operation *inside);
  void visit(Value value);
  void visitResult(OpResult result);
  void visitArgument(BlockArgument argument);

  Region &region;
  llvm::DenseSet<Value> live;
  llvm::SmallVector<Value> worklist;
  llvm::DenseSet<Operation *> controlled;
};

} // namespace mlir::tai

#endif // TAI_ANALYSIS_CARRIEDVALUES_H
