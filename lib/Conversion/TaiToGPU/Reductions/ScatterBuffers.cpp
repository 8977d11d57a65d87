//===- ScatterBuffers.cpp - Sums of a field's elements beside it ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "ScatterBuffers.h"
#include "tai/Transforms/Utils/IndexMath.h"

using namespace mlir;
using namespace mlir::tai;

bool tai::isInBuffer(Operation *op, ReductionForm form) {
  auto atomic = dyn_cast<AtomicOp>(op);
  ReductionAttr reduction = atomic ? atomic.getReductionAttr() : nullptr;
  return reduction && reduction.getForm() == form;
}

LogicalResult tai::splitBufferedLoops(
    LLVM::LLVMFuncOp host, ReductionForm form,
    function_ref<LogicalResult(ParallelForOp, ArrayRef<AtomicOp>)> split) {
  llvm::MapVector<Operation *, SmallVector<AtomicOp>> atomics;
  WalkResult result = host.walk([&](AtomicOp atomic) {
    if (!isInBuffer(atomic, form))
      return WalkResult::advance();
    auto loop = atomic->getParentOfType<ParallelForOp>();
    bool isWide = form == ReductionForm::Fixed ||
                  atomic.getReductionAttr().getDigits() != SumDigits::Own;
    if (loop && isDeviceLoop(loop) && isWide && atomic.getOld().use_empty()) {
      atomics[loop].push_back(atomic);
      return WalkResult::advance();
    }
    atomic.emitOpError("has a buffer, which on a GPU only sums of floats in "
                       "wide digits have whose old value nobody uses; expects "
                       "tai-relax-atomics=on-device to run before");
    return WalkResult::interrupt();
  });
  if (result.wasInterrupted())
    return failure();
  for (auto &[loop, found] : atomics)
    if (failed(split(cast<ParallelForOp>(loop), found)))
      return failure();
  return success();
}

Value tai::emitTerm(OpBuilder &builder, AtomicOp atomic) {
  if (atomic.getKind() == AtomicKind::Add)
    return atomic.getValue();
  return arith::NegFOp::create(builder, atomic.getLoc(), atomic.getValue());
}

Value tai::emitSumNumber(OpBuilder &builder, AtomicOp atomic,
                         const ScatterBuffer &buffer) {
  const FieldInfo &field = *buffer.field;
  Location loc = atomic.getLoc();
  IndexMath math(builder, loc);
  SmallVector<Value> zeroBased =
      emitZeroBased(builder, loc, field, atomic.getIndices());
  Value number = math.constant(0);
  for (auto [index, extent, fixed] :
       llvm::zip_equal(zeroBased, field.layout.shape, buffer.fixed))
    if (!fixed)
      number = math.add(math.mul(number, extent), index);
  if (field.numComponents == 1)
    return number;
  return math.add(
      math.mul(number, field.numComponents),
      emitComponent(builder, loc, field.elementShape, atomic.getComponents()));
}

void tai::emitElementLoop(
    OpBuilder &outside, Location loc, const ScatterBuffer &buffer,
    function_ref<void(OpBuilder &, Value number, Value element)> emit) {
  const FieldInfo &field = *buffer.field;
  IndexMath around(outside, loc);
  // Terms of addresses that all elements share are computed once, before the
  // loop.
  SmallVector<Value> zeroBased(field.layout.shape.size());
  for (auto [i, fixed] : llvm::enumerate(buffer.fixed))
    if (fixed)
      zeroBased[i] = around.sub(fixed, field.layout.offset[i]);
  auto over = ParallelForOp::create(outside, loc, around.constant(0),
                                    around.constant(buffer.count));
  OpBuilder builder = OpBuilder::atBlockBegin(&over.getBody().front());
  IndexMath math(builder, loc);
  Value number = over.getInductionVars().front(), rest = number;
  SmallVector<Value> components(field.elementShape.size());
  auto takeDigit = [&](int64_t extent) {
    Value digit = math.rem(rest, extent);
    rest = math.div(rest, extent);
    return digit;
  };
  for (size_t i = components.size(); i-- > 0;)
    components[i] = takeDigit(field.elementShape[i]);
  for (size_t i = zeroBased.size(); i-- > 0;)
    if (!buffer.fixed[i])
      zeroBased[i] = takeDigit(field.layout.shape[i]);
  Value element = emitPointer(
      builder, loc, getStorageType(field.scalarType), buffer.fieldBase,
      emitElementOffset(builder, loc, field, zeroBased, components));
  emit(builder, number, element);
}

void tai::emitRoundedAddition(OpBuilder &builder, Location loc, Type scalar,
                              Value sum, Value element) {
  Value old = emitLoad(builder, loc, scalar, element, AliasScopes());
  old = arith::ExtFOp::create(builder, loc, sum.getType(), old);
  Value total = arith::AddFOp::create(builder, loc, old, sum);
  emitStore(builder, loc, arith::TruncFOp::create(builder, loc, scalar, total),
            element, AliasScopes());
}
