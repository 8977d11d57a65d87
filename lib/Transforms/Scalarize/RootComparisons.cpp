//===- RootComparisons.cpp - Comparisons of square roots ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `(a - b).norm() < h` needs no square root: the root is correctly rounded and
// never decreases, so that sqrt(s) < h exactly if s < t, where t is the least
// number whose root is not below h. It is found by trying the neighbours of
// h * h, and is seldom h * h itself.
//
// A norm scales its operands if the sum of the squares leaves a range. Limits
// are well inside the roots of this range, so that a norm with scaled operands
// is on the same side of the limit as the sum of the squares.
//
//===----------------------------------------------------------------------===//

#include "Scalarizer.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/FloatFacts.h"
#include <cmath>

using namespace mlir;
using namespace mlir::tai;
using Predicate = arith::CmpFPredicate;

/// Returns the least number whose square root is at least `limit`.
template <typename Real> static Real getLeastSquare(Real limit) {
  constexpr Real infinity = std::numeric_limits<Real>::infinity();
  Real square = limit * limit;
  while (std::sqrt(square) >= limit)
    square = std::nextafter(square, Real(0));
  while (std::sqrt(square) < limit)
    square = std::nextafter(square, infinity);
  return square;
}

/// Returns the least number whose root is at least `limit`, or, with `isAbove`,
/// greater than `limit`; none if norms near it may have scaled operands.
template <typename Real>
static std::optional<APFloat> getThreshold(Real limit, bool isAbove, Real least,
                                           Real greatest) {
  if (!(limit >= least && limit <= greatest))
    return std::nullopt;
  if (isAbove)
    limit = std::nextafter(limit, std::numeric_limits<Real>::infinity());
  return APFloat(getLeastSquare(limit));
}

static std::optional<APFloat> getThreshold(const APFloat &limit, Type type,
                                           bool isAbove) {
  if (type.isF32())
    return getThreshold<float>(limit.convertToFloat(), isAbove, 0x1p-49F,
                               0x1p+63F);
  if (type.isF64())
    return getThreshold<double>(limit.convertToDouble(), isAbove, 0x1p-479,
                                0x1p+510);
  return std::nullopt;
}

/// Describes the comparison `square ? threshold` that stands for `root ?
/// limit`: its predicate, and whether the threshold is that of roots above the
/// limit.
static std::optional<std::pair<Predicate, bool>>
getSquarePredicate(Predicate predicate) {
  switch (predicate) {
  case Predicate::OLT:
  case Predicate::ULT:
  case Predicate::OGE:
  case Predicate::UGE:
    return std::pair(predicate, false);
  case Predicate::OLE:
    return std::pair(Predicate::OLT, true);
  case Predicate::ULE:
    return std::pair(Predicate::ULT, true);
  case Predicate::OGT:
    return std::pair(Predicate::OGE, true);
  case Predicate::UGT:
    return std::pair(Predicate::UGE, true);
  default:
    return std::nullopt;
  }
}

/// Returns the predicate that turns `limit ? root` into `root ? limit`.
static Predicate swapSides(Predicate predicate) {
  switch (predicate) {
  case Predicate::OLT:
    return Predicate::OGT;
  case Predicate::OLE:
    return Predicate::OGE;
  case Predicate::OGT:
    return Predicate::OLT;
  case Predicate::OGE:
    return Predicate::OLE;
  case Predicate::ULT:
    return Predicate::UGT;
  case Predicate::ULE:
    return Predicate::UGE;
  case Predicate::UGT:
    return Predicate::ULT;
  case Predicate::UGE:
    return Predicate::ULE;
  default:
    return predicate;
  }
}

/// True if `root` is the square root of a number that is not negative, or a
/// norm.
static bool isRoot(Value root, FloatFacts &facts) {
  if (auto norm = root.getDefiningOp<NormOp>())
    // A norm of one component is its magnitude, and no root.
    return cast<VectorType>(norm.getVector().getType()).getNumElements() > 1;
  auto sqrt = root.getDefiningOp<math::SqrtOp>();
  return sqrt && facts.isNonNegative(sqrt.getOperand());
}

/// Returns the number of which `root` is the square root.
static Value getSquare(Value root) {
  if (auto sqrt = root.getDefiningOp<math::SqrtOp>())
    return sqrt.getOperand();
  auto norm = root.getDefiningOp<NormOp>();
  OpBuilder builder(norm);
  return DotOp::create(builder, norm.getLoc(), norm.getType(), norm.getVector(),
                       norm.getVector());
}

void tai::compareSquares(FunctionOpInterface function) {
  SmallVector<arith::CmpFOp> comparisons;
  function.walk([&](arith::CmpFOp op) { comparisons.push_back(op); });
  for (arith::CmpFOp op : comparisons) {
    FloatFacts facts;
    Value root = op.getLhs(), other = op.getRhs();
    Predicate predicate = op.getPredicate();
    if (!isRoot(root, facts)) {
      std::swap(root, other);
      predicate = swapSides(predicate);
    }
    APFloat limit(0.0);
    auto square = getSquarePredicate(predicate);
    if (!square || !isRoot(root, facts) ||
        !matchPattern(other, m_ConstantFloat(&limit)))
      continue;
    std::optional<APFloat> threshold =
        getThreshold(limit, root.getType(), square->second);
    if (!threshold)
      continue;
    OpBuilder builder(op);
    Value constant = arith::ConstantOp::create(
        builder, op.getLoc(), builder.getFloatAttr(root.getType(), *threshold));
    auto compared = arith::CmpFOp::create(builder, op.getLoc(), square->first,
                                          getSquare(root), constant);
    compared.setFastmathAttr(op.getFastmathAttr());
    op.replaceAllUsesWith(compared.getResult());
    op.erase();
    if (root.use_empty())
      root.getDefiningOp()->erase();
  }
}
