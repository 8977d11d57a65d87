//===- Sums.h - Sums of all iterations of a loop ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOGPU_SUMS_H
#define TAI_LIB_CONVERSION_TAITOGPU_SUMS_H

#include "Offload.h"
#include "tai/Transforms/Utils/Accumulation.h"

namespace mlir::tai {

/// A sum over the iterations of a loop.
struct Sum {
  SmallVector<Operation *> updates;
  AtomicKind kind;
  Type type;
  /// Of what a thread keeps: f64 for sums of f32.
  Type kept;
  /// Where it goes, or the first of the partial sums.
  Value target;
  bool isPartial = false;
  ArrayAttr scope;
  Value slot;
};

/// How many threads keep a float sum of this loop in deterministic mode.
/// Depends on the loop alone.
int64_t getSumThreads(ParallelForOp loop);

/// Finds the sums again that prepareSums has numbered, and takes the marks
/// away.
SmallVector<Sum> collectSums(ParallelForOp loop, FieldTable &fields);

/// Makes the slot in which a thread keeps its part, lets the updates go there,
/// and adds what is there to the target.
void emitSumStart(OpBuilder &builder, Location loc, Sum &sum);
void rewriteUpdates(Sum &sum);
void emitSumEnd(OpBuilder &builder, Location loc, Sum &sum,
                RuntimeCalls &runtime);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOGPU_SUMS_H
