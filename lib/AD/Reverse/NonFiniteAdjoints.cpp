//===- NonFiniteAdjoints.cpp - Adjoints that may be infinite or NaN -------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "NonFiniteAdjoints.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

void NonFiniteAdjoints::beginRule(Operation *op) {
  seedIsInfinite = createInfinityTest(op);
  seedIsUndefined = llvm::any_of(op->getResults(), [&](Value result) {
    return mayBeUndefined.contains(result);
  });
}

void NonFiniteAdjoints::endRule() {
  seedIsInfinite = {};
  seedIsUndefined = false;
}

/// Whether some adjoint of a result of `op` is infinite; null where that cannot
/// be.
Value NonFiniteAdjoints::createInfinityTest(Operation *op) {
  Value any;
  seeds.clear();
  for (Value result : op->getResults()) {
    Value size = b.getAdjoint(result);
    if (!size)
      continue;
    seeds.insert(size);
    if (!mayBeInfinite.contains(result))
      continue;
    size = math::AbsFOp::create(b, size);
    if (isa<VectorType>(size.getType()))
      size = SumOp::create(b, getElementTypeOrSelf(size.getType()), size);
    Value infinity = b.createConstant(size.getType(),
                                      std::numeric_limits<double>::infinity());
    Value test =
        arith::CmpFOp::create(b, arith::CmpFPredicate::OEQ, size, infinity);
    any = any ? Value(arith::OrIOp::create(b, any, test)) : test;
  }
  return any;
}

/// What a rule has made of the adjoints that it starts from, with 1 in their
/// place: the partial derivative. Null where it is not made by a few plain ops.
Value NonFiniteAdjoints::createUnitContribution(Value contribution) {
  SmallVector<Operation *> slice;
  DenseMap<Value, bool> known;
  auto depends = [&](auto &self, Value value) -> bool {
    if (seeds.contains(value))
      return true;
    Operation *op = value.getDefiningOp();
    if (!op || op->getBlock() != b.getInsertionBlock())
      return false;
    if (auto it = known.find(value); it != known.end())
      return it->second;
    bool any = false;
    for (Value operand : op->getOperands())
      any |= self(self, operand);
    known[value] = any;
    if (any && !llvm::is_contained(slice, op))
      slice.push_back(op);
    return any;
  };
  constexpr size_t most = 64;
  if (!depends(depends, contribution) || slice.size() > most ||
      llvm::any_of(slice, [](Operation *op) {
        return op->getNumRegions() != 0 || !isMemoryEffectFree(op);
      }))
    return {};
  IRMapping mapping;
  for (Value seed : seeds)
    mapping.map(seed, b.createConstant(seed.getType(), 1));
  for (Operation *op : slice)
    b.clone(*op, mapping);
  return mapping.lookup(contribution);
}

/// What an infinite adjoint contributes: nothing where the partial derivative
/// is zero, and not the NaN that the product of both is. A partial that is
/// itself no number stays one.
Value NonFiniteAdjoints::guard(Value value, Value contribution) {
  if (seedIsUndefined)
    mayBeUndefined.insert(value);
  if (!seedIsInfinite)
    return contribution;
  mayBeInfinite.insert(value);
  auto isOrdered = [&](arith::CmpFPredicate predicate, Value number) {
    return arith::CmpFOp::create(b, predicate, number, number);
  };
  Value isNaN = isOrdered(arith::CmpFPredicate::UNO, contribution);
  if (Value partial = createUnitContribution(contribution);
      partial && !matchPattern(partial, m_Constant()))
    isNaN = arith::AndIOp::create(
        b, isNaN, isOrdered(arith::CmpFPredicate::ORD, partial));
  Value infinite = seedIsInfinite;
  if (isa<VectorType>(isNaN.getType()))
    infinite = vector::BroadcastOp::create(b, isNaN.getType(), infinite);
  Value drops = arith::AndIOp::create(b, infinite, isNaN);
  return arith::SelectOp::create(b, drops, b.createZero(contribution.getType()),
                                 contribution);
}
