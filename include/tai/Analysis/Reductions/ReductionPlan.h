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
    /// No other iteration reaches the element.
    bool isExclusive = false;
    /// Null for an update that is exclusive or atomic.
    ReductionAttr reduction;
    /// Why an update is atomic, or empty.
    StringRef reason;
  };
  /// The plan of each `tai.atomic`, and of each update of an array from outside
  /// the loop.
  llvm::MapVector<Operation *, Update> updates;
  /// The order of the loop, if its results must not depend on threads.
  std::optional<LoopOrder> order;
  /// Whether one thread runs the loop, and whether one warp runs it.
  bool isSerial = false, inWarp = false;
  /// No iteration accesses memory that another iteration writes.
  bool isIndependent = false;

  bool isExclusive(Operation *op) const {
    return updates.lookup(op).isExclusive;
  }
  bool isDoneByLoop(Operation *op) const {
    return updates.lookup(op).reduction != nullptr;
  }
  /// Writes the plan to the loop and its updates.
  void apply(ParallelForOp loop) const;
};

/// Whether the results of the kernel or function that `op` is, or is in, must
/// depend neither on the number of threads nor on timing.
bool hasFixedBits(Operation *op);

/// Whether its sums have, besides, the order that all targets share.
bool hasCommonOrder(Operation *op);

/// How a kernel adds up several terms of one iteration.
enum class TermSum { Plain, WithErrors, Unavailable };

/// The sum that a gather of terms of type `scalar` in `loop` makes. `pairs`:
/// the target can keep a sum of f64 with its rounding errors.
TermSum planGatheredSum(ParallelForOp loop, Type scalar, bool pairs);

/// Plans a loop from which invariant code has been moved: invariant indices
/// tell which part of a field is updated. `onDevice`: for a GPU. Emits an error
/// and fails at a sum that cannot have the digits for which the kernel asks.
FailureOr<ReductionPlan> planReductions(ParallelForOp loop, FieldTable &fields,
                                        bool onDevice);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_REDUCTIONS_REDUCTIONPLAN_H
