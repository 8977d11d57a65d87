//===- LoopBox.h - Parallel loops with known bounds -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_LOOPBOX_H
#define TAI_ANALYSIS_LOOPBOX_H

#include "tai/Dialect/Tai/IR/Tai.h"
#include <optional>

namespace mlir::tai {

/// A parallel loop whose induction variables run over constants.
struct LoopBox {
  ParallelForOp loop;
  SmallVector<int64_t> lower, upper;

  ArrayRef<BlockArgument> ivs() { return loop.getInductionVars(); }
  Block &body() { return loop.getBody().front(); }
  /// The position of `value` among the induction variables, if it is one.
  std::optional<unsigned> find(Value value);
};

/// The box of `loop`: its bounds, or those of the field that it visits. Nothing
/// where they are not constants, or the field has a sparse level.
std::optional<LoopBox> getConstantBox(ParallelForOp loop);

/// The boxes of the loops below `root` that run their iterations in parallel
/// over bounds that are written out, and stand in no other such loop. None in a
/// kernel that checks its indices: what asks makes other loops of them.
SmallVector<LoopBox> findConstantBoxes(Operation *root);

/// The same for any field: indices that a loop over active cells may have.
std::optional<LoopBox> getIndexBox(ParallelForOp loop);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_LOOPBOX_H
