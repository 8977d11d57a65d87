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

/// The elements that the iterations of a loop own, along each loop index: the
/// range of the loop itself, or a larger one.
struct Owned {
  SmallVector<int64_t> lower, upper;

  bool operator!=(const Owned &other) const {
    return lower != other.lower || upper != other.upper;
  }
};

/// Describes how an addition's index depends on a loop index: in the iterations
/// of [lower, upper) it is the shifted loop index; each of a few iterations at
/// a border, the strays, adds to an element of its own.
struct IndexSource {
  struct Stray {
    int64_t iteration, element;
  };

  IndexShift shift;
  int64_t lower, upper;
  SmallVector<Stray, 0> strays;

  bool isIdentity() const { return shift.isIdentity() && strays.empty(); }
};

/// An addition to an element that other iterations add to as well (a scatter),
/// whose terms can be gathered.
struct Scatter {
  AtomicOp op;
  /// The `scf.if` ops around `op`, outermost first.
  SmallVector<scf::IfOp> conditions;
  /// For each induction variable: the dimension of the field whose index
  /// depends on it, and how this index depends on it.
  SmallVector<unsigned> dimension;
  SmallVector<IndexSource> source;
  /// All elements to which the scatter may add.
  Owned owned;

  /// The number of terms that the scatter adds to an element: one for each
  /// choice of shift or stray along each index.
  unsigned getNumTerms() const {
    unsigned count = 1;
    for (const IndexSource &each : source)
      count *= 1 + each.strays.size();
    return count;
  }
};

/// The scatters, that is, atomic additions at indices that depend on the
/// iteration, whose elements are in one slice of a field.
using Group = SmallVector<Scatter, 0>;

/// The reason why additions stay scattered, in words for the author of the
/// program.
struct GatherRefusal {
  /// The op that decided.
  Operation *at = nullptr;
  std::string reason;
  /// True if all iterations add to one element, so that the addition is a sum
  /// and no scatter.
  bool isSum = false;

  void set(Operation *op, const Twine &why) {
    at = op;
    reason = why.str();
  }
};

/// Returns the layout of the field whose active cells the loop visits; failure
/// for other loops.
FailureOr<FieldLayout> getSparseLoopField(ParallelForOp loop);

/// Groups the additions to one field by slice and component. Empty if one of
/// them cannot be gathered, or may conflict with another access. `owned` are
/// the elements that the loop has been extended to, if it has been. `isStable`
/// tells which reads may be repeated. `why` gets the reason if the result is
/// empty.
SmallVector<Group> getGroups(FieldOp field, LoopBox &box,
                             ArrayRef<AtomicOp> atomics,
                             const std::optional<Owned> &owned, unsigned maxOps,
                             llvm::function_ref<bool(LoadOp)> isStable,
                             GatherRefusal &why);

/// True if only the scatters in `groups` may reach the elements that they add
/// to, and no other access of the loop.
bool isOnlyAccess(FieldOp field, LoopBox &box, MutableArrayRef<Group> groups,
                  GatherRefusal &why);

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_ACCUMULATIONS_SCATTERS_H
