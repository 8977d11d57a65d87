//===- Sums.h - Sums of all iterations of a loop ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOGPU_REDUCTIONS_SUMS_H
#define TAI_LIB_CONVERSION_TAITOGPU_REDUCTIONS_SUMS_H

#include "tai/Conversion/TaiToGPU/Offload.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"

namespace mlir::tai {

/// A sum over all iterations of a device loop.
struct Sum {
  SmallVector<Operation *> updates;
  AtomicKind kind;
  Type type;
  /// The accumulator type of a thread: f64 for sums of f32.
  Type kept;
  /// The address to which the sum is added or, for a partial sum, of the first
  /// partial sum.
  Value target;
  bool isPartial = false;
  /// True if blocks add to an f64, which a later loop adds to the f32 element.
  bool isWide = false;
  ArrayAttr scope;
  Value slot;
};

/// Returns the number of threads that keep partial float sums in deterministic
/// mode. It depends on the loop alone, not on the device.
int64_t getSumThreads(ParallelForOp loop);

/// Collects the sums that prepareSums has numbered in the loop, and removes the
/// marks.
SmallVector<Sum> collectSums(ParallelForOp loop, FieldTable &fields);

/// Create the thread's accumulator, redirect the updates to it, and add it to
/// the target.
void emitSumStart(OpBuilder &builder, Location loc, Sum &sum);
void rewriteUpdates(Sum &sum);
void emitSumEnd(OpBuilder &builder, Location loc, Sum &sum,
                RuntimeCalls &runtime);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOGPU_REDUCTIONS_SUMS_H
