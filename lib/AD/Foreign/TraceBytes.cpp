//===- TraceBytes.cpp - Memory that traces take ---------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "TraceBytes.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/ControlFlow/IR/ControlFlowOps.h"
#include "mlir/IR/Matchers.h"
#include "tai/AD/Foreign/Traces.h"

using namespace mlir;
using namespace mlir::tai;

std::optional<int64_t> tai::getConstant(Value value) {
  APInt constant;
  if (matchPattern(value, m_ConstantInt(&constant)))
    return constant.getSExtValue();
  return std::nullopt;
}

uint64_t tai::getBytes(Type type) {
  if (type.isIndex())
    return 8;
  if (auto vector = dyn_cast<VectorType>(type))
    return vector.getNumElements() * getBytes(vector.getElementType());
  return (type.getIntOrFloatBitWidth() + 7) / 8;
}

bool tai::hasBytes(Type type) {
  if (auto vector = dyn_cast<VectorType>(type))
    return !vector.isScalable() && hasBytes(vector.getElementType());
  return type.isIntOrIndexOrFloat();
}

std::optional<uint64_t> tai::getAllocatedBytes(memref::AllocOp array) {
  MemRefType type = array.getType();
  if (!hasBytes(type.getElementType()))
    return std::nullopt;
  uint64_t bytes = getBytes(type.getElementType());
  for (int64_t extent : type.getShape())
    if (!ShapedType::isDynamic(extent))
      bytes *= extent;
  for (Value extent : array.getDynamicSizes()) {
    std::optional<int64_t> constant = getConstant(extent);
    if (!constant)
      return std::nullopt;
    bytes *= *constant;
  }
  return bytes;
}

bool tai::isDefinedBefore(Value value, Operation *op) {
  Operation *definition = value.getDefiningOp();
  Operation *outer =
      definition ? op->getBlock()->findAncestorOpInBlock(*definition) : nullptr;
  return !outer || outer->isBeforeInBlock(op);
}

bool TraceBytes::add(ImplicitLocOpBuilder &b, Value array, Operation *op) {
  auto alloc = array.getDefiningOp<memref::AllocOp>();
  if (!alloc)
    return false;
  if (std::optional<uint64_t> bytes = getAllocatedBytes(alloc)) {
    known += static_cast<int64_t>(*bytes);
    return true;
  }
  MemRefType type = alloc.getType();
  if (alloc->getBlock() != op->getBlock() || !hasBytes(type.getElementType()))
    return false;
  int64_t factor = static_cast<int64_t>(getBytes(type.getElementType()));
  for (int64_t extent : type.getShape())
    factor *= ShapedType::isDynamic(extent) ? 1 : extent;
  Value size = arith::ConstantIndexOp::create(b, factor);
  for (Value extent : alloc.getDynamicSizes()) {
    if (!isDefinedBefore(extent, op))
      return false;
    size = b.createOrFold<arith::MulIOp>(size, extent);
  }
  values.push_back(size);
  return true;
}

Value TraceBytes::sum(ImplicitLocOpBuilder &b) const {
  Value total = arith::ConstantIndexOp::create(b, known);
  for (Value value : values)
    total = b.createOrFold<arith::AddIOp>(total, value);
  return total;
}

void tai::assertBytes(ImplicitLocOpBuilder &b, Value fits, StringRef name,
                      int64_t limit) {
  cf::AssertOp::create(
      b, fits,
      b.getStringAttr("the copies and records of the derivative of '@" + name +
                      "' take more than " + Twine(limit) + " bytes"));
}

LogicalResult tai::assertTraces(Block &body, StringRef name,
                                ArrayRef<Value> arrays, int64_t limit) {
  memref::AllocOp last;
  for (Value array : arrays) {
    auto alloc = array.getDefiningOp<memref::AllocOp>();
    if (!alloc)
      return failure();
    if (getAllocatedBytes(alloc))
      continue;
    if (alloc->getBlock() != &body)
      return failure();
    if (!last || last->isBeforeInBlock(alloc))
      last = alloc;
  }
  if (!last)
    return failure();
  ImplicitLocOpBuilder b(last.getLoc(), last);
  TraceBytes bytes;
  for (Value array : arrays)
    if (!bytes.add(b, array, last))
      return failure();
  Value fits = arith::CmpIOp::create(b, arith::CmpIPredicate::sle, bytes.sum(b),
                                     arith::ConstantIndexOp::create(b, limit));
  assertBytes(b, fits, name, limit);
  return success();
}
