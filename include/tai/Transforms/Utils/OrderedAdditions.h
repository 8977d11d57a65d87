//===- OrderedAdditions.h - Additions that a warp does together -*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// In deterministic mode, loops whose float additions meet in memory run on one
// warp of a GPU, if its threads can come to each addition together. See
// docs/decisions/0016-ordered-scatters.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_ORDEREDADDITIONS_H
#define TAI_TRANSFORMS_UTILS_ORDEREDADDITIONS_H

#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Utils/FieldAddress.h"

namespace mlir::tai {

using OpPredicate = llvm::function_ref<bool(Operation *)>;

/// The op because of which threads with different iterations of `loop` do not
/// come to its additions together, or null: a loop whose trips depend on the
/// iteration, say. Conditions around an addition alone are none.
Operation *findDivergence(ParallelForOp loop, OpPredicate isAddition);

/// True if the additions of `loop` that are neither exclusive nor sums of all
/// iterations can be done in an order that only the numbers of iterations
/// decide, by threads that do all else at the same time: nothing in the loop
/// sees what other iterations do.
bool canOrderAdditions(ParallelForOp loop, FieldTable &fields);

/// The same for the order of iterations: no element gets more than one of the
/// additions of an iteration, so that it does not matter that threads do one
/// addition of 32 iterations after another.
bool canQueueAdditions(ParallelForOp loop, FieldTable &fields);

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_ORDEREDADDITIONS_H
