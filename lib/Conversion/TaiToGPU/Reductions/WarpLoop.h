//===- WarpLoop.h - Loops that one warp executes ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOGPU_REDUCTIONS_WARPLOOP_H
#define TAI_LIB_CONVERSION_TAITOGPU_REDUCTIONS_WARPLOOP_H

#include "Sums.h"

namespace mlir::tai {

/// The number of threads in the block of a loop that runs in one warp.
constexpr int64_t kWarpSize = 32;

/// Attribute of a call of an ordered addition: the alias scopes of the updated
/// memory, or a unit attribute if they are unknown.
constexpr llvm::StringLiteral kOrderedScopeAttrName = "tai.ordered_scope";

/// Describes the share of a thread in a loop that tai-relax-atomics assigned to
/// a warp.
struct WarpPart {
  /// The warp runs batches of iterations, which start at the iterations
  /// `first`, `first` + `step`, ...
  Value first, step;
  /// An i1 value that is true if the current thread belongs to the warp that
  /// runs the loop.
  Value isHere;
  /// The number of the thread in the warp; null where one thread runs all
  /// iterations, because threads might not reach the additions together.
  Value lane;
};

/// Simplifies the body of a loop that one warp runs, so that its additions can
/// be analysed.
void prepareWarpLoop(ParallelForOp loop);

/// Distributes the `count` iterations of `loop` over the threads of a warp.
/// Must be called before the body of the loop is moved. `thread` is the number
/// of this thread.
WarpPart emitWarpPart(OpBuilder &builder, ParallelForOp loop, Value thread,
                      Value count, RuntimeCalls &runtime);

/// Emits a barrier for the threads of the warp.
void emitWarpBarrier(OpBuilder &builder, Location loc, const WarpPart &part,
                     RuntimeCalls &runtime);

/// Replaces the additions in `body`, which all threads of the warp run
/// together, by ordered additions, or with `inTurn` by additions of one lane
/// after the other. Threads without an iteration (`isActive` is false) repeat
/// another iteration and have no other effect.
void orderAdditions(Block *body, Value isActive, bool inTurn,
                    RuntimeCalls &runtime);

/// Stores the partial sums of the threads of the warp, and zeros for the
/// remaining partial sums.
void storeParts(OpBuilder &builder, Location loc, Sum &sum, Value thread,
                Value threads, int64_t count);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOGPU_REDUCTIONS_WARPLOOP_H
