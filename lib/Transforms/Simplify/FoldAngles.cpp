//===- FoldAngles.cpp - Folds atan2 before upstream does ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Upstream folds atan2(0, 0) to NaN, which afterwards cannot be distinguished
// from a NaN in the program. And it drops a pair of casts from index to a
// narrow integer and back, whether or not the index fits.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"
#include "llvm/ADT/TypeSwitch.h"
#include <cmath>

namespace mlir::tai {
#define GEN_PASS_DEF_FOLDANGLES
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;

namespace {
/// Evaluates constant expressions, each of them once.
class Constants {
public:
  /// Returns the constant that equals `value`; null if the value is not
  /// constant.
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
  // Folding may change an op in place without yielding a constant, so a copy is
  // folded.
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

/// Returns the components of a constant.
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

/// Returns the angles as a constant, if one of them is the angle of the origin.
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

/// True if the index fits 32 bits, as the indices of all fields do: a loop
/// index, a size, a constant or integer of that width, or a sum of these.
static bool isOfIndexSpace(Value value) {
  if (auto argument = dyn_cast<BlockArgument>(value)) {
    Operation *parent = argument.getOwner()->getParentOp();
    if (auto loop = dyn_cast<scf::ForOp>(parent))
      return argument == loop.getInductionVar();
    return isa<tai::ParallelForOp>(parent);
  }
  APInt constant;
  if (matchPattern(value, m_ConstantInt(&constant)))
    return constant.isSignedIntN(32);
  Operation *op = value.getDefiningOp();
  if (isa<arith::AddIOp, arith::SubIOp>(op))
    return llvm::all_of(op->getOperands(), isOfIndexSpace);
  if (isa<arith::RemUIOp, arith::RemSIOp>(op))
    return isOfIndexSpace(op->getOperand(1));
  if (auto cast = dyn_cast<arith::IndexCastOp>(op))
    return cast.getIn().getType().getIntOrFloatBitWidth() <= 32;
  if (auto cast = dyn_cast<arith::IndexCastUIOp>(op))
    return cast.getIn().getType().getIntOrFloatBitWidth() < 32;
  // Results of arith ops, branches, loops and local variables may be any
  // number.
  return !isa_and_present<arith::ArithDialect, scf::SCFDialect>(
             op->getDialect()) &&
         !isa<tai::LocalLoadOp>(op);
}

/// A cast of an index to a narrow integer becomes a truncation: index_cast %x :
/// index to i8 -> trunci (index_cast %x : index to i64) to i8
template <typename Op> static bool keepTruncation(Op op) {
  auto narrow = dyn_cast<IntegerType>(op.getType());
  if (!narrow || !op.getIn().getType().isIndex() || narrow.getWidth() >= 64 ||
      (narrow.getWidth() >= 32 && isOfIndexSpace(op.getIn())))
    return false;
  OpBuilder builder(op);
  Value extended =
      Op::create(builder, op.getLoc(), builder.getI64Type(), op.getIn());
  op.replaceAllUsesWith(
      arith::TruncIOp::create(builder, op.getLoc(), narrow, extended)
          .getResult());
  return true;
}

namespace {
struct FoldAngles : tai::impl::FoldAnglesBase<FoldAngles> {
  using Base::Base;

  void runOnOperation() override {
    Constants constants;
    // The cache of constants is keyed by the addresses of values, so ops are
    // erased last.
    SmallVector<Operation *> replaced;
    tai::walkOwned(getOperation(), [&](Operation *owned) {
      owned->walk([&](math::Atan2Op op) {
        TypedAttr angle = foldAngle(op, constants);
        if (!angle)
          return;
        OpBuilder builder(op);
        op.replaceAllUsesWith(
            arith::ConstantOp::create(builder, op.getLoc(), angle).getResult());
        replaced.push_back(op);
      });
      owned->walk([&](Operation *op) {
        bool isReplaced =
            llvm::TypeSwitch<Operation *, bool>(op)
                .Case<arith::IndexCastOp, arith::IndexCastUIOp>(
                    [](auto cast) { return keepTruncation(cast); })
                .Default(false);
        if (isReplaced)
          replaced.push_back(op);
      });
    });
    for (Operation *op : replaced)
      op->erase();
  }
};
} // namespace
