//===- Magnitudes.cpp - Bounds of numbers that are tested -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Magnitudes.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "llvm/ADT/TypeSwitch.h"
#include <cmath>

using namespace mlir;
using namespace mlir::tai;

static constexpr double kNone = std::numeric_limits<double>::infinity();

/// The greatest bound that leaves room for rounding.
static double getLimit(Type type) {
  if (type.isF32())
    return 1e37;
  return type.isF64() ? 1e300 : 0;
}

bool Magnitudes::isFinite(Value value) { return getBound(value) < kNone; }

double Magnitudes::getBound(Value value) {
  auto [it, isNew] = bounds.try_emplace(value, kNone);
  if (!isNew)
    return it->second;
  double bound = computeBound(value);
  if (!(bound <= getLimit(value.getType())))
    bound = kNone;
  return bounds[value] = bound;
}

double Magnitudes::computeBound(Value value) {
  Attribute constant;
  if (matchPattern(value, m_Constant(&constant))) {
    auto number = dyn_cast<FloatAttr>(constant);
    double magnitude = number ? std::abs(number.getValueAsDouble()) : kNone;
    return std::isnan(magnitude) ? kNone : magnitude;
  }
  if (isLeaf(value))
    return kLeafBound;
  Operation *op = value.getDefiningOp();
  if (!op)
    return kNone;
  auto of = [&](unsigned number) { return getBound(op->getOperand(number)); };
  return llvm::TypeSwitch<Operation *, double>(op)
      .Case<arith::AddFOp, arith::SubFOp>(
          [&](Operation *) { return of(0) + of(1); })
      .Case([&](arith::MulFOp) {
        double bound = of(0) * of(1);
        return std::isnan(bound) ? kNone : bound;
      })
      .Case([&](math::FmaOp) {
        double bound = of(0) * of(1) + of(2);
        return std::isnan(bound) ? kNone : bound;
      })
      .Case([&](arith::DivFOp quotient) {
        Value divisor = quotient.getRhs();
        if (!isFinite(divisor) || !facts.isNonZero(divisor, op))
          return kNone;
        return of(0) / FloatFacts::getClearance(divisor.getType());
      })
      .Case([&](math::SqrtOp) {
        return facts.isNonNegative(op->getOperand(0), op) ? std::max(1.0, of(0))
                                                          : kNone;
      })
      .Case<math::SinOp, math::CosOp, math::TanhOp, math::ErfOp>(
          [&](Operation *) { return of(0) < kNone ? 1.0 : kNone; })
      .Case([&](math::AtanOp) { return of(0) < kNone ? 2.0 : kNone; })
      .Case([&](math::ExpOp exp) {
        if (of(0) == kNone)
          return kNone;
        double high = facts.getRange(exp.getOperand(), op).high;
        return std::exp(std::min(high, of(0)));
      })
      .Case<arith::NegFOp, math::AbsFOp, arith::ExtFOp, arith::TruncFOp>(
          [&](Operation *) { return of(0); })
      .Case<math::FloorOp, math::CeilOp>([&](Operation *) { return of(0) + 1; })
      .Case<arith::MaximumFOp, arith::MinimumFOp, arith::MaxNumFOp,
            arith::MinNumFOp>(
          [&](Operation *) { return std::max(of(0), of(1)); })
      .Case<arith::SelectOp>(
          [&](Operation *) { return std::max(of(1), of(2)); })
      .Case<arith::SIToFPOp, arith::UIToFPOp>([](Operation *) { return 2e19; })
      .Case([&](scf::IfOp branch) {
        unsigned number = cast<OpResult>(value).getResultNumber();
        return std::max(getBound(branch.thenYield().getOperand(number)),
                        getBound(branch.elseYield().getOperand(number)));
      })
      .Default([](Operation *) { return kNone; });
}

void Magnitudes::addLeaves(Value value, llvm::SetVector<Value> &leaves) {
  SmallVector<Value> open{value};
  DenseSet<Value> seen;
  while (!open.empty()) {
    Value next = open.pop_back_val();
    // Values without a bound were not used in a proof.
    if (!seen.insert(next).second || !bounds.contains(next))
      continue;
    Operation *op = next.getDefiningOp();
    if (op && op->hasTrait<OpTrait::ConstantLike>())
      continue;
    if (isLeaf(next)) {
      leaves.insert(next);
      continue;
    }
    if (!op)
      continue;
    open.append(op->operand_begin(), op->operand_end());
    for (Region &region : op->getRegions())
      if (!region.empty())
        llvm::append_range(open, region.front().getTerminator()->getOperands());
  }
}
