//===- SharedElements.h - Elements that iterations share --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Whether several iterations of a parallel loop reach the element of an access,
// and whether two expressions of one iteration are the same value.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_SHAREDELEMENTS_H
#define TAI_ANALYSIS_SHAREDELEMENTS_H

#include "tai/Analysis/Index/IndexExpr.h"
#include "tai/Interfaces/Differentiable.h"
#include "llvm/ADT/DenseSet.h"

namespace mlir::tai {
class ParallelForOp;
struct LoopBox;

enum class Sharing {
  /// No other iteration of the loop reaches the element by the access.
  Own,
  /// Unknown: the indices depend on data, or the access is under a condition
  /// that possibly holds for one iteration only.
  Possible,
  /// Every iteration reaches the element; or every iteration in which a
  /// condition holds that is not an equality, and so selects more than one
  /// iteration.
  Certain
};

/// Whether iterations of `loop`, which contains `access`, share the element.
Sharing getSharing(DifferentiableAccessInterface access, ParallelForOp loop);

/// Removes from `box` the iterations in which the access does not run, as far
/// as conditions compare one index with a constant. Returns false if the access
/// is under a condition of another kind, or in a loop inside the box's loop.
bool narrowToAccess(Operation *access, LoopBox &box);

/// Bounds of the indices of a parallel loop, in addition to the loop's own
/// bounds. The bounds of each dimension consist of values from outside of the
/// loop.
struct IndexLimits {
  /// For each dimension, lower bounds: the index is at least each expression.
  SmallVector<SmallVector<IndexExpr, 1>> lower;
  /// For each dimension, upper bounds: the index is less than each expression.
  SmallVector<SmallVector<IndexExpr, 1>> upper;
};

/// The iterations in which the access runs, as far as conditions compare one
/// index with values from outside of the loop. No value if the access is under
/// a condition of another kind, or in a loop inside `loop`.
std::optional<IndexLimits> getLimits(Operation *access, ParallelForOp loop);

/// Compares values and accesses of one iteration of a loop. Equal expressions
/// are equal values; so are two loads of an element that the loop does not
/// write in between.
class SameIteration {
public:
  explicit SameIteration(ParallelForOp loop);

  bool areEqual(Value lhs, Value rhs, unsigned depth = 16) const;
  bool areEqual(ValueRange lhs, ValueRange rhs) const;
  /// True if the accesses `lhs` and `rhs`, made in one iteration, certainly
  /// reach the same element or component.
  bool reachSame(DifferentiableAccessInterface lhs,
                 DifferentiableAccessInterface rhs) const;

private:
  /// The storages that the loop writes: two loads of an element in them are
  /// equal only if no write lies between the loads.
  llvm::DenseSet<const void *> written;
};

} // namespace mlir::tai

#endif // TAI_ANALYSIS_SHAREDELEMENTS_H
