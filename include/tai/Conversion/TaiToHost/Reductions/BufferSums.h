//===- BufferSums.h - Sums of a part of a field -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Each partition has a copy of the updated part of the field, with the digits
// that the plan chose, and the runtime adds the copies to the field. With the
// field's own digits, a single partition adds to the field itself.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CONVERSION_TAITOHOST_REDUCTIONS_BUFFERSUMS_H
#define TAI_CONVERSION_TAITOHOST_REDUCTIONS_BUFFERSUMS_H

#include "tai/Analysis/Reductions/Accumulation.h"
#include "tai/Conversion/TaiToHost/Lowering.h"

namespace mlir::tai {

class BufferSums {
public:
  /// Creates the buffers of a group of additions. Fails with an error if the
  /// updated part of the field is not evenly spaced in memory.
  static FailureOr<BufferSums> create(AccumulationGroup group,
                                      ParallelForOp loop);

  double getUpdatesPerIteration() const { return updatesPerIteration; }
  int64_t getNumElements() const {
    return slice.numCells * group.field->numComponents;
  }

  /// Emits code in the kernel before the loop, which allocates the buffers.
  /// `single`: true if there is only one partition.
  void emitBefore(OpBuilder &builder, Location loc, ModuleLowering &lowering,
                  Value frame, Value parts, Value single);
  /// Emit code in the loop's function: at its entry, and in place of the
  /// updates.
  void emitEntry(OpBuilder &builder, Location loc, Value part);
  void rewriteUpdates(ModuleLowering &lowering);
  /// Emits code in the kernel after the loop. `whereSeveral` inserts at a point
  /// that is reached only if there are several partitions.
  void emitAfter(OpBuilder &builder, OpBuilder &whereSeveral, Location loc,
                 ModuleLowering &lowering, Value frame, Value parts);

private:
  BufferSums(AccumulationGroup group, FieldSlice slice)
      : group(std::move(group)), slice(std::move(slice)) {}
  int64_t getScalarBytes() const;
  /// True if every partition has a buffer, so that no partition updates the
  /// field itself.
  bool isApart() const { return digits != SumDigits::Own; }
  int64_t getCompactStride() const {
    return group.field->numComponents * group.field->scalarSize;
  }
  bool isContiguous() const { return slice.cellStride == getCompactStride(); }
  Value emitTarget(OpBuilder &builder, Location loc);
  int32_t getCombineKind() const;

  AccumulationGroup group;
  FieldSlice slice;
  double updatesPerIteration = 0;
  SumDigits digits = SumDigits::Own;
  // Valid in the kernel:
  Value target, memory, partStride, cellStride;
  // The address of the partition's buffer, a value of the loop's function:
  Value base;
};

} // namespace mlir::tai

#endif // TAI_CONVERSION_TAITOHOST_REDUCTIONS_BUFFERSUMS_H
