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

/// A parallel loop with constant bounds.
struct LoopBox {
  ParallelForOp loop;
  SmallVector<int64_t> lower, upper;

  ArrayRef<BlockArgument> ivs() { return loop.getInductionVars(); }
  Block &body() { return loop.getBody().front(); }
  /// The position of `value` among the induction variables, if it is one.
  std::optional<unsigned> find(Value value);
};

/// The box of `loop`: its bounds, or the index space of the field that it
/// visits. Returns no value if the bounds are not constants, or the field has a
/// sparse level.
std::optional<LoopBox> getConstantBox(ParallelForOp loop);

/// The boxes of the outermost parallel loops below `root` with explicit
/// constant bounds. Empty in a kernel that checks indices at run time, because
/// callers restructure these loops.
SmallVector<LoopBox> findConstantBoxes(Operation *root);

/// Like getConstantBox, but also for fields with sparse levels: the box is a
/// superset of the indices that a loop over active cells visits.
std::optional<LoopBox> getIndexBox(ParallelForOp loop);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_LOOPBOX_H
