//===- WarpLoop.h - Loops that one warp runs --------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOGPU_WARPLOOP_H
#define TAI_LIB_CONVERSION_TAITOGPU_WARPLOOP_H

#include "Sums.h"

namespace mlir::tai {

/// Threads of the block in which such a loop runs.
constexpr int64_t kWarpSize = 32;

/// On a call that does an addition in order: the scopes of what it updates, or
/// a unit where they are not known.
constexpr llvm::StringLiteral kOrderedScopeAttrName = "tai.ordered_scope";

/// The part of a thread in a loop that tai-relax-atomics has given to a warp.
struct WarpPart {
  /// The numbers from `first` on, in steps, are the first of those that the
  /// warp does at a time.
  Value first, step;
  /// Whether this thread is one of the warp.
  Value isHere;
  /// The number of the thread; null where one thread does all, since the
  /// others could not come to the additions with it.
  Value lane;
};

/// Brings the loop into the form in which most can be found out about it.
void prepareWarpLoop(ParallelForOp loop);

/// Decides how the threads do `loop`, of `count` iterations, as long as it is
/// whole; `thread` is the number of this one.
WarpPart emitWarpPart(OpBuilder &builder, ParallelForOp loop, Value thread,
                      Value count, RuntimeCalls &runtime);

/// Lets the threads of the warp wait for each other and see what all wrote.
void emitMeeting(OpBuilder &builder, Location loc, const WarpPart &part,
                 RuntimeCalls &runtime);

/// Makes the additions in `body`, which all threads of the warp run together,
/// ordered ones. Threads that have no iteration, so that `isActive` is false,
/// have the number of another one and do nothing else.
void orderAdditions(Block *body, Value isActive, bool inTurn,
                    RuntimeCalls &runtime);

/// Stores the parts that threads of the warp have of a sum, and that of others,
/// which changes nothing.
void storeParts(OpBuilder &builder, Location loc, Sum &sum, Value thread,
                Value threads, int64_t count);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOGPU_WARPLOOP_H
