//===- Scatters.h - Additions that can be gathered --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The additions of a parallel loop whose every index is a shift of one loop
// index, so that the iteration that owns an element can make all of them.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_ACCUMULATIONS_SCATTERS_H
#define TAI_LIB_TRANSFORMS_ACCUMULATIONS_SCATTERS_H

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Analysis/Index/IndexShift.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// The elements that the iterations of a loop own, along each of its indices:
/// those of the loop itself, or more.
struct Owned {
  SmallVector<int64_t> lower, upper;

  bool operator!=(const Owned &other) const {
    return lower != other.lower || upper != other.upper;
  }
};

/// How an addition's index depends on an index of the loop: the iterations of
/// [lower, upper) shift it, and each of a few others, at a border, adds to an
/// element of its own.
struct IndexSource {
  struct Stray {
    int64_t iteration, element;
  };

  IndexShift shift;
  int64_t lower, upper;
  SmallVector<Stray, 0> strays;

  bool isIdentity() const { return shift.isIdentity() && strays.empty(); }
};

/// One addition that can be gathered.
struct Scatter {
  AtomicOp op;
  /// The `scf.if` ops around it, outermost first.
  SmallVector<scf::IfOp> conditions;
  /// For each induction variable, the dimension of the field that it indexes
  /// and how it does.
  SmallVector<unsigned> dimension;
  SmallVector<IndexSource> source;
  /// All elements that may be added to.
  Owned owned;

  /// The number of terms that an element gets: one for each choice of shift or
  /// stray along each index.
  unsigned getNumTerms() const {
    unsigned count = 1;
    for (const IndexSource &each : source)
      count *= 1 + each.strays.size();
    return count;
  }
};

/// Additions to one slice of a field.
using Group = SmallVector<Scatter, 0>;

/// The field that a loop over active cells visits, if it is one.
FailureOr<FieldLayout> getSparseLoopField(ParallelForOp loop);

/// Groups the additions to one field by slice and component. Empty if one of
/// them cannot be gathered, or another access might meet them. If the loop has
/// been made to own other elements than its own, those are `owned`. `isStable`
/// tells which reads may be done again.
SmallVector<Group> getGroups(FieldOp field, LoopBox &box,
                             ArrayRef<AtomicOp> atomics,
                             const std::optional<Owned> &owned, unsigned maxOps,
                             llvm::function_ref<bool(LoadOp)> isStable);

/// True if nothing else in the loop may touch the elements of the groups.
bool isOnlyAccess(FieldOp field, LoopBox &box, MutableArrayRef<Group> groups);

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_ACCUMULATIONS_SCATTERS_H
