//===- SharedFactors.cpp - Factors that operands share --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "SharedFactors.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"

using namespace mlir;
using namespace mlir::tai;

using Ways = SmallVector<std::pair<Value, Value>, 3>;

/// Lists all ways to write `value` as a factor times a cofactor; a null
/// cofactor stands for 1. A product is taken apart if it is in the block of
/// `user`.
static Ways split(Value value, Operation *user) {
  Ways ways = {{value, Value()}};
  if (auto product = value.getDefiningOp<arith::MulFOp>();
      product && product->getBlock() == user->getBlock()) {
    ways.push_back({product.getLhs(), product.getRhs()});
    ways.push_back({product.getRhs(), product.getLhs()});
  }
  return ways;
}

static std::optional<SharedFactor> findShared(Operation *op) {
  Ways lefts, rights;
  if (auto fma = dyn_cast<math::FmaOp>(op)) {
    lefts = {{fma.getA(), fma.getB()}, {fma.getB(), fma.getA()}};
    rights = split(fma.getC(), op);
  } else {
    lefts = split(op->getOperand(0), op);
    rights = split(op->getOperand(1), op);
  }
  for (auto [first, left] : lefts)
    for (auto [second, right] : rights)
      if (first == second)
        return SharedFactor{first, {left, right}};
  return std::nullopt;
}

std::optional<SharedFactor> mlir::tai::findFactorOfRatio(Operation *op) {
  if (!isa<arith::DivFOp, math::Atan2Op>(op))
    return std::nullopt;
  return findShared(op);
}

bool mlir::tai::extendSharedSum(Operation *op, TangentBuilder &b) {
  if (!isa<arith::AddFOp, arith::SubFOp, math::FmaOp>(op))
    return false;
  std::optional<SharedFactor> shared = findShared(op);
  if (!shared)
    return false;
  auto [factor, rest] = *shared;
  Value tangent = b.getTangent(factor);
  auto hasTangent = [&](Value value) { return value && b.getTangent(value); };
  if (!tangent || !b.mayBeNonFinite(factor) || hasTangent(rest[0]) ||
      hasTangent(rest[1]))
    return false;
  bool isSum = !isa<arith::SubFOp>(op);
  // The difference s - s is zero, and so is its derivative.
  if (!rest[0] && !rest[1] && !isSum)
    return true;
  bool mayBeNonFinite = false;
  for (Value value : rest)
    mayBeNonFinite |= value && b.getFacts().mayBeNonFinite(value);
  Value one = b.createConstant(tangent.getType(), 1);
  Value left = rest[0] ? rest[0] : one, right = rest[1] ? rest[1] : one;
  Value slope = isSum ? arith::AddFOp::create(b, left, right).getResult()
                      : arith::SubFOp::create(b, left, right).getResult();
  Value product = arith::MulFOp::create(b, tangent, slope);
  b.setTangent(
      op->getResult(0),
      b.createProduct(factor, product, mayBeNonFinite, [&] { return slope; }));
  return true;
}
