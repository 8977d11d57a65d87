//===- WideScatters.cpp - Additions that are rounded once -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Additions of 16-bit floats, and those of kernels with compensated sums, go to
// sums of f64 beside the field. A sum of f64 has its rounding error beside it:
// an atomic addition returns what was there before, from which its error
// follows exactly (Knuth, TAOCP 4.2.2, theorem B). The errors add up in any
// order.
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

/// Sums of f64 have their errors beside them.
static int64_t getNumParts(const ScatterBuffer &buffer) {
  return buffer.field->scalarType.isF64() ? 2 : 1;
}

static Value emitPart(OpBuilder &builder, Location loc,
                      const ScatterBuffer &buffer, Value number, int64_t part) {
  IndexMath math(builder, loc);
  return emitPointer(
      builder, loc, builder.getF64Type(), buffer.sums,
      math.add(math.mul(number, getNumParts(buffer)), math.constant(part)));
}

/// The rounding error of a + b, which is `sum`.
static Value emitError(OpBuilder &builder, Location loc, Value a, Value b,
                       Value sum) {
  auto add = [&](Value x, Value y) -> Value {
    return arith::AddFOp::create(builder, loc, x, y);
  };
  auto subtract = [&](Value x, Value y) -> Value {
    return arith::SubFOp::create(builder, loc, x, y);
  };
  Value partB = subtract(sum, a);
  return add(subtract(a, subtract(sum, partB)), subtract(b, partB));
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
  lowering.device.runtime.call(builder, loc, name, Type(),
                               {emitPart(builder, loc, to, number, 0), term});
  atomic.erase();
}

/// Adds a sum to its element. A replay begins with zeros.
void WideScatter::emitResult(OpBuilder &builder, const ScatterBuffer &from,
                             Value number, Value element) {
  Location loc = loop.getLoc();
  Type wide = builder.getF64Type(), type = from.field->scalarType;
  Value zero =
      arith::ConstantOp::create(builder, loc, builder.getF64FloatAttr(0));
  auto takePart = [&](int64_t part) {
    Value address = emitPart(builder, loc, from, number, part);
    Value found = emitLoad(builder, loc, wide, address, AliasScopes());
    emitStore(builder, loc, zero, address, AliasScopes());
    return found;
  };
  Value sum = takePart(0);
  Value old = emitLoad(builder, loc, type, element, AliasScopes());
  if (!type.isF64())
    old = arith::ExtFOp::create(builder, loc, wide, old);
  Value total = arith::AddFOp::create(builder, loc, old, sum);
  if (getNumParts(from) == 2) {
    // The error of a sum that is not finite is none.
    Value error = arith::AddFOp::create(
        builder, loc, takePart(1), emitError(builder, loc, old, sum, total));
    Value exact = arith::AddFOp::create(builder, loc, total, error);
    Value none = arith::MulFOp::create(builder, loc, total, zero);
    Value isFinite = arith::CmpFOp::create(
        builder, loc, arith::CmpFPredicate::ORD, none, none);
    total = arith::SelectOp::create(builder, loc, isFinite, exact, total);
  } else {
    total = arith::TruncFOp::create(builder, loc, type, total);
  }
  emitStore(builder, loc, total, element, AliasScopes());
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
  auto atomics =
      findInBuffers(host, [](Type type) { return isa<FloatType>(type); });
  if (failed(atomics))
    return failure();
  for (auto &[loop, found] : *atomics)
    if (failed(
            WideScatter(cast<ParallelForOp>(loop), frame, lowering).run(found)))
      return failure();
  return success();
}
