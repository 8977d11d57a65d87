//===- FoldAngles.cpp - Folds atan2 of zeros ------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Upstream folds atan2(0, 0) to NaN, which afterwards cannot be distinguished
// from a NaN in the program.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Transforms/Passes.h"
#include <cmath>

namespace mlir::tai {
#define GEN_PASS_DEF_FOLDANGLES
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;

namespace {
/// What values are that are computed from constants.
class Constants {
public:
  /// Null if it is not known.
  Attribute get(Value value) {
    if (auto known = attributes.find(value); known != attributes.end())
      return known->second;
    Attribute found = compute(value);
    attributes[value] = found;
    return found;
  }

private:
  Attribute compute(Value value);

  DenseMap<Value, Attribute> attributes;
};
} // namespace

Attribute Constants::compute(Value value) {
  Attribute attribute;
  if (matchPattern(value, m_Constant(&attribute)))
    return attribute;
  Operation *op = value.getDefiningOp();
  if (!op || op->getNumRegions() != 0 || op->getNumOperands() == 0 ||
      !isMemoryEffectFree(op))
    return {};
  SmallVector<Attribute> operands;
  for (Value operand : op->getOperands()) {
    operands.push_back(get(operand));
    if (!operands.back())
      return {};
  }
  // Folding may change the op where it gives no constant.
  Operation *copy = op->clone();
  SmallVector<OpFoldResult> results;
  bool isFolded = succeeded(copy->fold(operands, results)) && !results.empty();
  copy->destroy();
  if (!isFolded)
    return {};
  OpFoldResult result = results[cast<OpResult>(value).getResultNumber()];
  if (auto made = dyn_cast<Attribute>(result))
    return made;
  return get(cast<Value>(result));
}

/// The components of a constant.
static SmallVector<APFloat> getNumbers(Attribute attribute) {
  if (auto elements = dyn_cast<DenseFPElementsAttr>(attribute))
    return llvm::to_vector(elements.getValues<APFloat>());
  if (auto number = dyn_cast<FloatAttr>(attribute))
    return {number.getValue()};
  return {};
}

static double toDouble(APFloat number) {
  bool ignored;
  number.convert(APFloat::IEEEdouble(), APFloat::rmNearestTiesToEven, &ignored);
  return number.convertToDouble();
}

/// The angle as a constant, if a component is that of the origin.
static TypedAttr foldAngle(math::Atan2Op op, Constants &constants) {
  Attribute y = constants.get(op.getLhs()), x = constants.get(op.getRhs());
  if (!x || !y)
    return {};
  SmallVector<APFloat> sines = getNumbers(y), cosines = getNumbers(x), angles;
  if (sines.size() != cosines.size())
    return {};
  bool hasOrigin = false;
  for (auto [sine, cosine] : llvm::zip(sines, cosines)) {
    hasOrigin |= sine.isZero() && cosine.isZero();
    APFloat angle(std::atan2(toDouble(sine), toDouble(cosine)));
    bool ignored;
    angle.convert(sine.getSemantics(), APFloat::rmNearestTiesToEven, &ignored);
    angles.push_back(angle);
  }
  if (!hasOrigin)
    return {};
  if (auto type = dyn_cast<ShapedType>(op.getType()))
    return DenseElementsAttr::get(type, angles);
  return FloatAttr::get(op.getType(), angles.front());
}

namespace {
struct FoldAngles : tai::impl::FoldAnglesBase<FoldAngles> {
  using Base::Base;

  void runOnOperation() override {
    Constants constants;
    // What is known is known by addresses.
    SmallVector<Operation *> replaced;
    getOperation()->walk([&](math::Atan2Op op) {
      TypedAttr angle = foldAngle(op, constants);
      if (!angle)
        return;
      OpBuilder builder(op);
      op.replaceAllUsesWith(
          arith::ConstantOp::create(builder, op.getLoc(), angle).getResult());
      replaced.push_back(op);
    });
    for (Operation *op : replaced)
      op->erase();
  }
};
} // namespace
