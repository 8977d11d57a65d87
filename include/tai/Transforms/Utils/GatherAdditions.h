//===- GatherAdditions.h - Gather the additions of a loop -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Turns additions to shifted elements into gathers, for passes that need them
// before `tai-scatter-to-gather` runs.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_GATHERADDITIONS_H
#define TAI_TRANSFORMS_UTILS_GATHERADDITIONS_H

#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

struct GatherOptions {
  /// The largest number of operations computed again for one field.
  unsigned maxOps = 256;
  /// True if sums of f64 may keep their rounding errors in a second sum.
  bool pairSums = true;
  bool onDevice = false;
  /// For ranks, the index of each read is that of the loop plus a constant, at
  /// the borders of the field, too. A trial for them emits no remarks.
  enum class Use { OneProcess, Ranks, TrialForRanks };
  Use use = Use::OneProcess;
};

/// Turns the additions of a loop over elements without sparse levels into
/// gathers where that is possible. Returns the loop, and a loop that repeats
/// stores after it, if there is one; nothing if no addition is gathered, after
/// which the loop is as fast as before.
SmallVector<ParallelForOp> gatherAdditions(ParallelForOp loop,
                                           const GatherOptions &options);

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_GATHERADDITIONS_H
