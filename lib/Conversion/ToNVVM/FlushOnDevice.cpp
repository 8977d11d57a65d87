//===- FlushOnDevice.cpp - Flush-to-zero functions of a GPU ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "DeviceFloats.h"
#include "mlir/IR/Builders.h"

using namespace mlir;
using namespace mlir::tai;

/// True if an operation computes on floats, so that a processor in flushing
/// mode flushes its denormal operands and results. Operations that only move
/// bits or change the sign keep denormals.
static bool computes(Operation *op) {
  return isa<LLVM::FAddOp, LLVM::FSubOp, LLVM::FMulOp, LLVM::FDivOp,
             LLVM::FRemOp, LLVM::FCmpOp, LLVM::FPExtOp, LLVM::FPTruncOp,
             LLVM::FMAOp, LLVM::FMulAddOp, LLVM::SqrtOp, LLVM::MinNumOp,
             LLVM::MaxNumOp, LLVM::MinimumOp, LLVM::MaximumOp>(op);
}

/// True for functions of the math library and instructions chosen by name,
/// which keep denormals.
static bool isLibraryCall(Operation *op) {
  if (isa<LLVM::CallIntrinsicOp>(op))
    return true;
  auto call = dyn_cast<LLVM::CallOp>(op);
  return call && call.getCallee() && call.getCallee()->starts_with("__nv_");
}

static bool isDouble(Value value) {
  return getElementTypeOrSelf(value.getType()).isF64();
}

/// Emits the flush of a number: %v -> |%v| < the least normal number ?
/// copysign(0, %v) : %v
static Value flush(OpBuilder &builder, Location loc, Value value) {
  Type type = value.getType();
  auto element = cast<FloatType>(getElementTypeOrSelf(type));
  auto constant = [&](const APFloat &number) -> Value {
    TypedAttr attr = builder.getFloatAttr(element, number);
    if (auto vector = dyn_cast<VectorType>(type))
      attr = DenseElementsAttr::get(vector, Attribute(attr));
    return LLVM::ConstantOp::create(builder, loc, type, attr);
  };
  const llvm::fltSemantics &semantics = element.getFloatSemantics();
  Value size = LLVM::FAbsOp::create(builder, loc, type, value);
  Value least = constant(APFloat::getSmallestNormalized(semantics));
  Value isSmall =
      LLVM::FCmpOp::create(builder, loc, LLVM::FCmpPredicate::olt, size, least);
  Value zero = LLVM::CopySignOp::create(
      builder, loc, type, constant(APFloat::getZero(semantics)), value);
  return LLVM::SelectOp::create(builder, loc, isSmall, zero, value);
}

void tai::flushOnDevice(LLVM::LLVMFuncOp function) {
  Builder builder(function.getContext());
  SmallVector<Attribute> all;
  if (ArrayAttr others = function.getPassthroughAttr())
    llvm::append_range(all, others);
  all.push_back(builder.getStrArrayAttr(
      {"denormal-fp-math-f32", "preserve-sign,preserve-sign"}));
  function.setPassthroughAttr(builder.getArrayAttr(all));

  SmallVector<Operation *> operations;
  function.walk([&](Operation *op) {
    if (computes(op) || isLibraryCall(op))
      operations.push_back(op);
  });
  for (Operation *op : operations) {
    OpBuilder at(op);
    for (OpOperand &operand : op->getOpOperands())
      if (isDouble(operand.get()))
        operand.set(flush(at, op->getLoc(), operand.get()));
    at.setInsertionPointAfter(op);
    for (OpResult result : op->getResults()) {
      bool isLibrarys = isLibraryCall(op) && isa<FloatType>(result.getType());
      if (!isDouble(result) && !isLibrarys)
        continue;
      Value flushed = flush(at, op->getLoc(), result);
      // All uses are replaced but the ones in the ops that compute `flushed`
      // itself.
      result.replaceUsesWithIf(flushed, [&](OpOperand &use) {
        Operation *user = use.getOwner();
        return user->getBlock() != op->getBlock() ||
               flushed.getDefiningOp()->isBeforeInBlock(user);
      });
    }
  }
}
