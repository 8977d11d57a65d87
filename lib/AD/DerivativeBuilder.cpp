//===- DerivativeBuilder.cpp - Shared by rules of both modes --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/AD/DerivativeBuilder.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/ZeroTests.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

DerivativeBuilder::DerivativeBuilder(FunctionOpInterface function,
                                     bool usesConditions)
    : ImplicitLocOpBuilder(function.getLoc(), function.getContext()),
      facts(usesConditions), conventions(Conventions::of(function)),
      isKernel(isa<KernelOp>(function.getOperation())) {}

DerivativeBuilder::~DerivativeBuilder() = default;

Value DerivativeBuilder::createConstant(Type type, double value) {
  Type element = getElementTypeOrSelf(type);
  TypedAttr attr = getFloatAttr(element, value);
  if (auto vector = dyn_cast<VectorType>(type))
    attr = DenseElementsAttr::get(vector, Attribute(attr));
  return arith::ConstantOp::create(*this, attr);
}

Value DerivativeBuilder::createExtract(Value vector, int64_t component) {
  // If `vector` was made from its components, the component itself is returned,
  // so that sums of components stay sums of scalars.
  if (auto elements = vector.getDefiningOp<vector::FromElementsOp>())
    return elements.getElements()[component];
  if (auto broadcast = vector.getDefiningOp<vector::BroadcastOp>();
      broadcast && !isa<VectorType>(broadcast.getSourceType()))
    return broadcast.getSource();
  auto type = cast<VectorType>(vector.getType());
  SmallVector<int64_t> position(type.getRank());
  for (int64_t dim = type.getRank() - 1; dim >= 0; --dim) {
    position[dim] = component % type.getDimSize(dim);
    component /= type.getDimSize(dim);
  }
  return vector::ExtractOp::create(*this, vector, position);
}

Value DerivativeBuilder::createVector(VectorType type,
                                      ArrayRef<Value> components) {
  SmallVector<Value> elements(components);
  Value zero;
  for (Value &element : elements)
    if (!element) {
      if (!zero)
        zero = createZero(type.getElementType());
      element = zero;
    }
  return vector::FromElementsOp::create(*this, type, elements);
}

Value DerivativeBuilder::createSum(Value vector) {
  auto type = cast<VectorType>(vector.getType());
  if (isKernel)
    return SumOp::create(*this, type.getElementType(), vector);
  if (type.getRank() == 0)
    return vector::ExtractOp::create(*this, vector, ArrayRef<int64_t>());
  auto flat = VectorType::get(type.getNumElements(), type.getElementType());
  if (type != flat)
    vector = vector::ShapeCastOp::create(*this, flat, vector);
  return vector::ReductionOp::create(*this, vector::CombiningKind::ADD, vector);
}

Value DerivativeBuilder::createMask(Value condition, Value value) {
  return arith::SelectOp::create(*this, condition, value,
                                 createZero(value.getType()));
}

Value DerivativeBuilder::createGuard(Value derivative, Value value) {
  if (!conventions.guards)
    return value;
  Value zero = createZero(derivative.getType());
  Value isZero =
      arith::CmpFOp::create(*this, arith::CmpFPredicate::OEQ, derivative, zero);
  if (derivative.getType() != value.getType())
    zero = createZero(value.getType());
  auto guard = arith::SelectOp::create(*this, isZero, zero, value);
  guard->setAttr(kGuard, getUnitAttr());
  return guard;
}

//===----------------------------------------------------------------------===//
// Guards
//===----------------------------------------------------------------------===//

void mlir::tai::noteGuards(FunctionOpInterface function) {
  auto kernel = dyn_cast<KernelOp>(function.getOperation());
  if (!kernel)
    return;
  WalkResult found = kernel.walk([](arith::SelectOp select) {
    return select->hasAttr(kGuard) ? WalkResult::interrupt()
                                   : WalkResult::advance();
  });
  if (found.wasInterrupted())
    kernel.setGuarded(true);
}

/// True if the select has the form `select (x == 0), 0, y` of a guard.
static bool looksLikeGuard(arith::SelectOp select) {
  return getTestedForZero(select) &&
         matchPattern(select.getTrueValue(), m_AnyZeroFloat());
}

LogicalResult mlir::tai::checkGuards(FunctionOpInterface function) {
  auto kernel = dyn_cast<KernelOp>(function.getOperation());
  if (!kernel || !kernel.getGuarded())
    return success();
  arith::SelectOp lost;
  bool isMarked = false;
  kernel.walk([&](arith::SelectOp select) {
    if (select->hasAttr(kGuard))
      isMarked = true;
    else if (!lost && looksLikeGuard(select))
      lost = select;
  });
  if (isMarked || !lost)
    return success();
  return lost->emitError("a guard of this gradient has lost its mark '")
         << kGuard
         << "', so that the gradient cannot be differentiated again; make the "
            "tangent before the pass that drops such attributes";
}
