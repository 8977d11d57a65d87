//===- ScatterBuffers.h - Sums of a field's elements beside it --*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Additions to data-dependent elements for which `tai-relax-atomics` chose a
// buffer: they go to scratch memory with a sum for each element, and a loop
// over the elements then adds the sums to the field.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOGPU_REDUCTIONS_SCATTERBUFFERS_H
#define TAI_LIB_CONVERSION_TAITOGPU_REDUCTIONS_SCATTERBUFFERS_H

#include "tai/Analysis/Reductions/Accumulation.h"
#include "tai/Conversion/TaiToGPU/Offload.h"

namespace mlir::tai {

/// The buffer that holds the sums of one group of additions to a field.
struct ScatterBuffer {
  explicit ScatterBuffer(const AccumulationGroup &group)
      : field(group.field), fixed(group.fixed),
        count(getNumAccumulators(group)) {}

  const FieldInfo *field;
  /// For each dimension of the field, the index that all additions share, or
  /// null.
  SmallVector<Value> fixed;
  /// The number of sums in the buffer: elements along dimensions without a
  /// shared index, times components.
  int64_t count;
  Value fieldBase, sums;
};

bool isInBuffer(Operation *op, ReductionForm form);

/// Calls `split` for each loop of a host function with additions of the form
/// `form`. Fails at an addition that a GPU does not support.
LogicalResult splitBufferedLoops(
    LLVM::LLVMFuncOp host, ReductionForm form,
    function_ref<LogicalResult(ParallelForOp, ArrayRef<AtomicOp>)> split);

/// Emits the term of an addition, negated for a subtraction.
Value emitTerm(OpBuilder &builder, AtomicOp atomic);

/// Emits the index, in the buffer, of the sum that an addition updates.
Value emitSumNumber(OpBuilder &builder, AtomicOp atomic,
                    const ScatterBuffer &buffer);

/// Emits a loop over the elements that the buffer has sums for. `emit` gets the
/// number of a sum and the address of its element.
void emitElementLoop(
    OpBuilder &builder, Location loc, const ScatterBuffer &buffer,
    function_ref<void(OpBuilder &, Value number, Value element)> emit);

/// Emits the addition of an f64 sum to an element of a narrower type, rounding
/// once.
void emitRoundedAddition(OpBuilder &builder, Location loc, Type scalar,
                         Value sum, Value element);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOGPU_REDUCTIONS_SCATTERBUFFERS_H
