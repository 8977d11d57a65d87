//===- OrderedAdditions.h - Deterministic additions by a warp ---*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// In deterministic mode, loops with float additions of several iterations to
// the same memory run on one warp of a GPU, if its threads can execute each
// addition together. See docs/decisions/0016-ordered-scatters.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_REDUCTIONS_ORDEREDADDITIONS_H
#define TAI_ANALYSIS_REDUCTIONS_ORDEREDADDITIONS_H

#include "tai/Analysis/FieldTable.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"

namespace mlir::tai {

using OpPredicate = llvm::function_ref<bool(Operation *)>;

/// The op that makes threads with different iterations of `loop` diverge before
/// one of its additions, or null: a loop whose trip count depends on the
/// iteration, for example. Conditions around the addition alone do not count.
Operation *findDivergence(ParallelForOp loop, OpPredicate isAddition);

/// True if the additions of `loop` that are neither exclusive nor sums over all
/// iterations can be executed in the order of iteration numbers while the rest
/// of the iterations runs in parallel: nothing in the loop reads the writes of
/// other iterations. `plan` says which additions are exclusive or such sums.
bool canOrderAdditions(ParallelForOp loop, FieldTable &fields,
                       const ReductionPlan &plan);

/// True if the additions of `loop` can be executed in the order of iteration
/// numbers (canOrderAdditions), and no element receives more than one addition
/// of an iteration. The order of iterations is then kept when the threads of a
/// warp execute one addition for 32 iterations before the next addition.
bool canQueueAdditions(ParallelForOp loop, FieldTable &fields,
                       const ReductionPlan &plan);

/// True if the values that the loop adds can be computed several times with the
/// same results, without other effects of the loop. `additions` receives the
/// additions, all of them to fields, whose old values are not used.
bool canAddInAnyOrder(ParallelForOp loop, FieldTable &fields,
                      const ReductionPlan &plan,
                      SmallVectorImpl<AtomicOp> &additions);

/// True if no two iterations of `loop` update the same element by `atomics`,
/// updates of one field.
bool haveOwnElements(ParallelForOp loop, ArrayRef<AtomicOp> atomics);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_REDUCTIONS_ORDEREDADDITIONS_H
