//===- ZeroTests.cpp - Choices by a test for zero -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/ZeroTests.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/IR/Matchers.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

Value mlir::tai::getTestedForZero(arith::SelectOp select) {
  auto test = select.getCondition().getDefiningOp<arith::CmpFOp>();
  if (!test || test.getPredicate() != arith::CmpFPredicate::OEQ ||
      !matchPattern(test.getRhs(), m_AnyZeroFloat()))
    return {};
  return test.getLhs();
}

Value mlir::tai::getGuarded(arith::SelectOp guard) {
  Value tested = getTestedForZero(guard);
  if (!tested)
    return {};
  // A test of all components of a matrix at once compares the sum of their
  // absolute values with zero.
  if (auto sum = tested.getDefiningOp<SumOp>())
    if (auto abs = sum.getVector().getDefiningOp<math::AbsFOp>())
      return abs.getOperand();
  return tested;
}
