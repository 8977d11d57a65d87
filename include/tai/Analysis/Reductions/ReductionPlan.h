//===- ReductionPlan.h - How a parallel loop does its updates ---*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The plan of a loop has for each update its form, the digits of its sum and
// the order of its terms, as #tai.reduction. Only the planner reads the modes
// of the kernel; lowerings read the attributes. See
// docs/decisions/0061-reductions.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_REDUCTIONS_REDUCTIONPLAN_H
#define TAI_ANALYSIS_REDUCTIONS_REDUCTIONPLAN_H

#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/MapVector.h"

namespace mlir::tai {

class FieldTable;

struct ReductionPlan {
  struct Update {
    /// True if no other iteration of the loop reaches the element of this
    /// update.
    bool isExclusive = false;
    /// How the partial results of this update are combined; null for an update
    /// that is exclusive or atomic.
    ReductionAttr reduction;
    /// For an atomic update: why the loop cannot reduce it. Otherwise empty.
    StringRef reason;
  };
  /// The plan of each `tai.atomic`, and of each update of an array from outside
  /// the loop.
  llvm::MapVector<Operation *, Update> updates;
  /// The order in which the loop adds terms, if its results must not depend on
  /// the number of threads.
  std::optional<LoopOrder> order;
  /// True if a single thread runs the loop; true if a single warp of a GPU runs
  /// it.
  bool isSerial = false, inWarp = false;
  /// True if no iteration of the loop accesses memory that another iteration
  /// writes.
  bool isIndependent = false;

  bool isExclusive(Operation *op) const {
    return updates.lookup(op).isExclusive;
  }
  bool isDoneByLoop(Operation *op) const {
    return updates.lookup(op).reduction != nullptr;
  }
  /// Writes the plan to attributes of the loop and its updates.
  void apply(ParallelForOp loop) const;
};

/// True if the kernel or function that contains (or is) `op` is in a mode in
/// which its results depend neither on the number of threads nor on timing.
bool hasFixedBits(Operation *op);

/// True if `op` is in a kernel or function whose sums, besides, have the order
/// that all targets share.
bool hasCommonOrder(Operation *op);

/// How a kernel adds up several terms of one iteration.
enum class TermSum { Plain, WithErrors, Unavailable };

/// How to add up the terms, of type `scalar`, that one iteration of `loop`
/// gathers for one element. `pairs`: the target can keep a sum of f64 together
/// with its rounding error.
TermSum planGatheredSum(ParallelForOp loop, Type scalar, bool pairs);

/// Plans the reductions of a loop. Invariant code must have been moved out of
/// the loop before: invariant indices tell which part of a field an update
/// reaches. `onDevice`: plan for a GPU. Emits an error and fails at a sum that
/// cannot have the digits for which the kernel asks.
FailureOr<ReductionPlan> planReductions(ParallelForOp loop, FieldTable &fields,
                                        bool onDevice);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_REDUCTIONS_REDUCTIONPLAN_H
