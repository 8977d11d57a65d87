//===- WideScatters.cpp - Additions that are rounded once -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Additions of 16-bit floats, additions of many f32 terms to each element, and
// additions in kernels with compensated sums go to sums of f64 beside the field
// (lib/DeviceLibrary/WideSums.cpp). A loop over the elements adds the sums to
// the field.
//
//===----------------------------------------------------------------------===//

#include "ScatterBuffers.h"
#include "tai/Transforms/Utils/IndexMath.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
class WideScatter {
public:
  WideScatter(ParallelForOp loop, Value frame, DeviceLowering &lowering)
      : loop(loop), frame(frame), lowering(lowering) {}
  LogicalResult run(ArrayRef<AtomicOp> atomics);

private:
  void emitAddition(AtomicOp atomic, const ScatterBuffer &to);
  void emitResult(OpBuilder &builder, const ScatterBuffer &from, Value number,
                  Value element);

  ParallelForOp loop;
  Value frame;
  DeviceLowering &lowering;
};
} // namespace

/// Returns the number of f64 in a sum: a sum of f64 terms needs a second one
/// for the rounding error.
static int64_t getNumParts(const ScatterBuffer &buffer) {
  return buffer.field->scalarType.isF64() ? 2 : 1;
}

static Value emitSumAddress(OpBuilder &builder, Location loc,
                            const ScatterBuffer &buffer, Value number) {
  IndexMath math(builder, loc);
  return emitPointer(builder, loc, builder.getF64Type(), buffer.sums,
                     math.mul(number, getNumParts(buffer)));
}

void WideScatter::emitAddition(AtomicOp atomic, const ScatterBuffer &to) {
  OpBuilder builder(atomic);
  Location loc = atomic.getLoc();
  Value term = emitTerm(builder, atomic);
  Value number = emitSumNumber(builder, atomic, to);
  if (!term.getType().isF64())
    term = arith::ExtFOp::create(builder, loc, builder.getF64Type(), term);
  StringRef name =
      getNumParts(to) == 2 ? "tai_dev_wide_add_f64" : "tai_dev_wide_add_f32";
  lowering.device.runtime.call(
      builder, loc, name, Type(),
      {emitSumAddress(builder, loc, to, number), term});
  atomic.erase();
}

/// Emits the addition of a sum to its element, and resets the sum to zero for a
/// replay.
void WideScatter::emitResult(OpBuilder &builder, const ScatterBuffer &from,
                             Value number, Value element) {
  Location loc = loop.getLoc();
  Type wide = builder.getF64Type(), type = from.field->scalarType;
  Value address = emitSumAddress(builder, loc, from, number);
  if (type.isF64()) {
    Value old = emitLoad(builder, loc, type, element, AliasScopes());
    Value total = lowering.device.runtime.call(
        builder, loc, "tai_dev_wide_take_f64", wide, {address, old});
    emitStore(builder, loc, total, element, AliasScopes());
    return;
  }
  Value sum = emitLoad(builder, loc, wide, address, AliasScopes());
  Value zero =
      arith::ConstantOp::create(builder, loc, builder.getF64FloatAttr(0));
  emitStore(builder, loc, zero, address, AliasScopes());
  emitRoundedAddition(builder, loc, type, sum, element);
}

LogicalResult WideScatter::run(ArrayRef<AtomicOp> atomics) {
  FailureOr<SmallVector<AccumulationGroup>> groups =
      groupAccumulations(loop, atomics, lowering.device.fields);
  if (failed(groups))
    return failure();
  Location loc = loop.getLoc();
  RuntimeCalls &runtime = lowering.host.runtime;
  for (const AccumulationGroup &group : *groups) {
    OpBuilder builder(loop);
    ScatterBuffer buffer(group);
    buffer.fieldBase = emitFieldBase(builder, loc, *buffer.field);
    int64_t bytes = buffer.count * getNumParts(buffer) * 8;
    buffer.sums = runtime.tai_rt_device_scratch(
        builder, loc, frame, runtime.i64(builder, loc, bytes));
    for (AtomicOp atomic : group.atomics)
      emitAddition(atomic, buffer);
    builder.setInsertionPointAfter(loop);
    emitElementLoop(builder, loc, buffer,
                    [&](OpBuilder &in, Value number, Value element) {
                      emitResult(in, buffer, number, element);
                    });
  }
  return success();
}

LogicalResult tai::splitWideScatters(LLVM::LLVMFuncOp host, Value frame,
                                     DeviceLowering &lowering) {
  return splitBufferedLoops(
      host, ReductionForm::Buffer,
      [&](ParallelForOp loop, ArrayRef<AtomicOp> atomics) {
        return WideScatter(loop, frame, lowering).run(atomics);
      });
}
