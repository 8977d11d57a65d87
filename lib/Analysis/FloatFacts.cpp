//===- FloatFacts.cpp - Facts about floats --------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/FloatFacts.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "tai/Analysis/ZeroTests.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Interfaces/Differentiable.h"
#include "llvm/ADT/TypeSwitch.h"
#include <cmath>
#include <limits>

using namespace mlir;
using namespace mlir::tai;

/// True if `value` is a constant all of whose components satisfy `predicate`.
static bool matchConstant(Value value,
                          function_ref<bool(const APFloat &)> predicate) {
  Attribute attr;
  if (!matchPattern(value, m_Constant(&attr)))
    return false;
  if (auto number = dyn_cast<FloatAttr>(attr))
    return predicate(number.getValue());
  auto dense = dyn_cast<DenseFPElementsAttr>(attr);
  if (dense && dense.isSplat())
    return predicate(dense.getSplatValue<APFloat>());
  return dense && llvm::all_of(dense.getValues<APFloat>(), predicate);
}

//===----------------------------------------------------------------------===//
// Ranges
//===----------------------------------------------------------------------===//

using Interval = FloatFacts::Interval;

static constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// The range of a constant's components, if `value` is a constant.
static std::optional<Interval> getConstantRange(Value value) {
  Interval range = {kInfinity, -kInfinity};
  bool isNumber = matchConstant(value, [&](const APFloat &x) {
    if (x.isNaN())
      return false;
    APFloat number = x;
    bool losesInfo;
    number.convert(APFloat::IEEEdouble(), APFloat::rmNearestTiesToEven,
                   &losesInfo);
    range.low = std::min(range.low, number.convertToDouble());
    range.high = std::max(range.high, number.convertToDouble());
    return true;
  });
  return isNumber ? std::optional(range) : std::nullopt;
}

/// Returns the bounds of a result of type `type`. Rounding is monotone, so a
/// rounded bound is a bound; a number that may underflow becomes 0. A NaN
/// bound, as from infinity minus infinity, means that there is no bound.
static Interval makeRange(double low, double high, Type type) {
  if (std::isnan(low))
    low = -kInfinity;
  if (std::isnan(high))
    high = kInfinity;
  Type element = getElementTypeOrSelf(type);
  if (!element.isF32() && !element.isF64()) // only signs are kept
    return {low >= 0 ? 0 : -kInfinity, high <= 0 ? 0 : kInfinity};
  auto round = [&](double bound) {
    double least = element.isF64() ? std::numeric_limits<double>::min()
                                   : std::numeric_limits<float>::min();
    if (std::abs(bound) < least)
      return 0.0;
    return element.isF64() ? bound
                           : static_cast<double>(static_cast<float>(bound));
  };
  return {round(low), round(high)};
}

double FloatFacts::getClearance(Type type) {
  Type element = getElementTypeOrSelf(type);
  return element.isF64() ? 1e-100 : element.isF32() ? 1e-12 : kInfinity;
}

static Interval addRanges(Interval a, Interval b, Type type) {
  return makeRange(a.low + b.low, a.high + b.high, type);
}

static Interval negate(Interval a) { return {-a.high, -a.low}; }

/// Multiplies ranges; 0 times infinity is 0, because zero is a value in the
/// range, whereas an infinite bound only says that there is no bound.
static Interval multiply(Interval a, Interval b, Type type) {
  auto product = [](double x, double y) {
    return x == 0 || y == 0 ? 0.0 : x * y;
  };
  double p[] = {product(a.low, b.low), product(a.low, b.high),
                product(a.high, b.low), product(a.high, b.high)};
  return makeRange(*llvm::min_element(p), *llvm::max_element(p), type);
}

/// Returns the range of a reciprocal, if no number in the range of the operand
/// is zero.
static Interval invert(Interval a, Type type) {
  return makeRange(1 / a.high, 1 / a.low, type);
}

static Interval join(Interval a, Interval b) {
  return {std::min(a.low, b.low), std::max(a.high, b.high)};
}

/// Returns the range of x * x, or of another even power of x, for x in `a`.
static Interval square(Interval a, Type type) {
  double least = std::max({a.low, -a.high, 0.0});
  return makeRange(least * least, kInfinity, type);
}

/// Narrows the range of `value`, given that `condition` has the value `holds`.
static void narrow(Interval &range, Value value, Value condition, bool holds,
                   unsigned depth) {
  Operation *op = condition.getDefiningOp();
  if (!op || depth-- == 0)
    return;
  // If a conjunction holds, both its parts hold; if a disjunction does not
  // hold, neither part holds.
  if ((holds && isa<arith::AndIOp>(op)) || (!holds && isa<arith::OrIOp>(op))) {
    narrow(range, value, op->getOperand(0), holds, depth);
    narrow(range, value, op->getOperand(1), holds, depth);
    return;
  }
  auto compare = dyn_cast<arith::CmpFOp>(op);
  if (!compare)
    return;
  Value lhs = compare.getLhs(), rhs = compare.getRhs();
  if (lhs != value && rhs != value)
    return;
  std::optional<Interval> bound = getConstantRange(lhs == value ? rhs : lhs);
  if (!bound)
    return;
  // Decides whether the comparison bounds `value`, on its left side, from above
  // or from below. If the comparison fails, the inverse comparison holds, since
  // `value` is assumed to be a number.
  using P = arith::CmpFPredicate;
  bool isAbove;
  switch (compare.getPredicate()) {
  case P::OLT:
  case P::ULT:
  case P::OLE:
  case P::ULE:
    isAbove = false;
    break;
  case P::OGT:
  case P::UGT:
  case P::OGE:
  case P::UGE:
    isAbove = true;
    break;
  default:
    return;
  }
  if (lhs != value)
    isAbove = !isAbove;
  if (!holds)
    isAbove = !isAbove;
  if (isAbove)
    range.low = std::max(range.low, bound->low);
  else
    range.high = std::min(range.high, bound->high);
}

Interval FloatFacts::getRange(Value value, Operation *at) {
  return getRange(value, at, kDepth);
}

Interval FloatFacts::getRange(Value value, Operation *at, unsigned depth) {
  Interval range = computeRange(value, at, depth);
  if (!usesConditions || !at)
    return range;
  // The range of the value is narrowed by the conditions of the branches around
  // `at`.
  for (Operation *op = at; Operation *parent = op->getParentOp(); op = parent)
    if (auto branch = dyn_cast<scf::IfOp>(parent))
      narrow(range, value, branch.getCondition(),
             op->getParentRegion() == &branch.getThenRegion(), kDepth);
  return range;
}

Interval FloatFacts::computeRange(Value value, Operation *at, unsigned depth) {
  const Interval all = {-kInfinity, kInfinity}, unit = {-1, 1};
  if (std::optional<Interval> constant = getConstantRange(value))
    return *constant;
  Operation *op = value.getDefiningOp();
  if (!op || depth-- == 0 || op->getNumResults() == 0)
    return all;
  Type type = value.getType();
  auto of = [&](Value operand) { return getRange(operand, at, depth); };
  auto atLeast = [](double low) { return Interval{low, kInfinity}; };
  return llvm::TypeSwitch<Operation *, Interval>(op)
      .Case([&](arith::AddFOp op) {
        return addRanges(of(op.getLhs()), of(op.getRhs()), type);
      })
      .Case([&](arith::SubFOp op) {
        return addRanges(of(op.getLhs()), negate(of(op.getRhs())), type);
      })
      .Case([&](arith::NegFOp op) { return negate(of(op.getOperand())); })
      .Case([&](arith::MulFOp op) {
        if (op.getLhs() == op.getRhs())
          return square(of(op.getLhs()), type);
        return multiply(of(op.getLhs()), of(op.getRhs()), type);
      })
      .Case([&](arith::DivFOp op) {
        Interval rhs = of(op.getRhs());
        // If the divisor is not negative, the quotient has the sign of the
        // dividend.
        Interval inverse = rhs.low >= 0    ? Interval{0, kInfinity}
                           : rhs.high <= 0 ? Interval{-kInfinity, 0}
                                           : all;
        if (rhs.low > 0 || rhs.high < 0)
          inverse = invert(rhs, type);
        return multiply(of(op.getLhs()), inverse, type);
      })
      .Case([&](math::FmaOp op) {
        Interval product = op.getA() == op.getB()
                               ? square(of(op.getA()), type)
                               : multiply(of(op.getA()), of(op.getB()), type);
        return addRanges(product, of(op.getC()), type);
      })
      .Case<arith::MaximumFOp, arith::MaxNumFOp>([&](auto op) {
        Interval a = of(op.getLhs()), b = of(op.getRhs());
        return Interval{std::max(a.low, b.low), std::max(a.high, b.high)};
      })
      .Case<arith::MinimumFOp, arith::MinNumFOp>([&](auto op) {
        Interval a = of(op.getLhs()), b = of(op.getRhs());
        return Interval{std::min(a.low, b.low), std::min(a.high, b.high)};
      })
      .Case([&](math::ClampFOp op) {
        // The result of a clamp whose bounds are in the wrong order is one of
        // the bounds.
        return join(of(op.getMin()), of(op.getMax()));
      })
      .Case([&](arith::SelectOp op) {
        Interval a = of(op.getTrueValue()), b = of(op.getFalseValue());
        if (!isa<VectorType>(op.getCondition().getType())) {
          // The arms of a select are narrowed by its condition, because a
          // maximum can be written as a select.
          narrow(a, op.getTrueValue(), op.getCondition(), true, depth);
          narrow(b, op.getFalseValue(), op.getCondition(), false, depth);
        }
        return join(a, b);
      })
      .Case([&](math::AbsFOp op) {
        Interval a = of(op.getOperand());
        return Interval{std::max({a.low, -a.high, 0.0}),
                        std::max(-a.low, a.high)};
      })
      .Case([&](math::SqrtOp op) {
        Interval a = of(op.getOperand());
        return makeRange(std::sqrt(std::max(a.low, 0.0)),
                         std::sqrt(std::max(a.high, 0.0)), type);
      })
      .Case([&](math::FPowIOp op) {
        APInt power;
        if (!matchPattern(op.getRhs(), m_ConstantInt(&power)) || power[0])
          return all;
        return power == 2 ? square(of(op.getLhs()), type) : atLeast(0);
      })
      .Case([&](math::PowFOp op) {
        return of(op.getLhs()).low >= 0 ? atLeast(0) : all;
      })
      .Case<math::ExpOp, math::Exp2Op, math::AcosOp, math::AcoshOp,
            math::ErfcOp, arith::UIToFPOp>([&](auto) { return atLeast(0); })
      .Case([&](NormOp op) {
        // The norm of a vector is at least as large as each component.
        double least = 0;
        if (auto elements =
                op.getVector().getDefiningOp<vector::FromElementsOp>())
          for (Value element : elements.getElements()) {
            Interval a = of(element);
            least = std::max({least, a.low, -a.high});
          }
        return makeRange(least, kInfinity, type);
      })
      .Case<math::ExpM1Op>([&](auto) { return atLeast(-1); })
      .Case<math::CoshOp>([&](auto) { return atLeast(1); })
      .Case<math::SinOp, math::CosOp, math::TanhOp, math::ErfOp>(
          [&](auto) { return unit; })
      .Case([&](DotOp op) {
        return op.getLhs() == op.getRhs() ? atLeast(0) : all;
      })
      .Case([&](SumOp op) {
        return of(op.getVector()).low >= 0 ? atLeast(0) : all;
      })
      .Case<arith::ExtFOp, arith::TruncFOp>([&](auto op) {
        Interval a = of(op.getIn());
        return makeRange(a.low, a.high, type);
      })
      .Case<vector::BroadcastOp, vector::ExtractOp>(
          [&](auto op) { return of(op.getSource()); })
      .Case<StopGradientOp, DeriveAsOp>(
          [&](auto op) { return of(op.getValue()); })
      .Default([&](Operation *) { return all; });
}

/// True if a quotient is v / |v|, or v / 1 where v is zero: its components have
/// a magnitude of at most 1, however small v is.
static bool isNormalization(Operation *op) {
  auto division = dyn_cast_if_present<arith::DivFOp>(op);
  if (!division)
    return false;
  Value divisor = division.getRhs();
  if (auto broadcast = divisor.getDefiningOp<vector::BroadcastOp>())
    divisor = broadcast.getSource();
  auto select = divisor.getDefiningOp<arith::SelectOp>();
  if (!select)
    return false;
  Value size = select.getFalseValue();
  if (getTestedForZero(select) != size ||
      !matchConstant(select.getTrueValue(), [](const APFloat &x) {
        return x.isFinite() && !x.isZero();
      }))
    return false;
  if (auto sum = size.getDefiningOp<arith::AddFOp>();
      sum && matchPattern(sum.getRhs(), m_AnyZeroFloat()))
    size = sum.getLhs();
  auto norm = size.getDefiningOp<NormOp>();
  return norm && norm.getVector() == division.getLhs();
}

/// True if fast-math flags of the op say that its result is finite.
static bool isPromisedFinite(Operation *op) {
  auto flagged = dyn_cast<arith::ArithFastMathInterface>(op);
  if (!flagged)
    return false;
  arith::FastMathFlagsAttr flags = flagged.getFastMathFlagsAttr();
  return flags &&
         bitEnumContainsAll(flags.getValue(), arith::FastMathFlags::nnan |
                                                  arith::FastMathFlags::ninf);
}

/// True if flags promise that the result of `at` is finite, which requires that
/// its operand `value` is not zero, and for a logarithm or root, positive.
static bool needsNonZero(Operation *at, Value value) {
  if (!at || !isPromisedFinite(at))
    return false;
  if (isa<arith::DivFOp>(at))
    return at->getOperand(1) == value;
  return isa<math::RsqrtOp, math::LogOp, math::Log2Op, math::Log10Op>(at);
}

bool FloatFacts::isPositive(Value value, Operation *at) {
  if (needsNonZero(at, value) && !isa<arith::DivFOp>(at))
    return true;
  return getRange(value, at).low >= getClearance(value.getType());
}
bool FloatFacts::isNonNegative(Value value, Operation *at) {
  return getRange(value, at).low >= 0;
}
bool FloatFacts::isNonZero(Value value, Operation *at) {
  if (needsNonZero(at, value))
    return true;
  // Constants are handled first, because the range of a vector constant with
  // components of both signs contains zero, although no component may be zero.
  if (matchConstant(
          value, [](const APFloat &x) { return x.isFinite() && !x.isZero(); }))
    return true;
  // The divisor of a normalisation v / |v| is not zero, and not smaller than
  // any component of v.
  if (isNormalization(at) && at->getOperand(1) == value)
    return true;
  Interval range = getRange(value, at);
  double clearance = getClearance(value.getType());
  return range.low >= clearance || range.high <= -clearance;
}
bool FloatFacts::isNonPositive(Value value, Operation *at) {
  return getRange(value, at).high <= 0;
}
bool FloatFacts::isInUnitInterval(Value value, Operation *at) {
  Interval range = getRange(value, at);
  return range.low >= -1 && range.high <= 1;
}

/// True for ops whose result can be infinite or NaN even if all operands are
/// finite.
static bool makesNonFinite(Operation *op, FloatFacts &facts) {
  if (isPromisedFinite(op))
    return false;
  return llvm::TypeSwitch<Operation *, bool>(op)
      .Case<arith::DivFOp, arith::RemFOp>(
          [&](auto op) { return !facts.isNonZero(op.getRhs(), op); })
      .Case<math::SqrtOp>(
          [&](auto op) { return !facts.isNonNegative(op.getOperand(), op); })
      .Case<math::RsqrtOp, math::LogOp, math::Log2Op, math::Log10Op>(
          [&](auto op) { return !facts.isPositive(op.getOperand(), op); })
      .Case<math::Log1pOp>(
          [&](auto op) { return !facts.isNonNegative(op.getOperand(), op); })
      .Case<math::ExpOp, math::Exp2Op, math::ExpM1Op>(
          [&](auto op) { return !facts.isNonPositive(op.getOperand(), op); })
      .Case<math::AcosOp, math::AsinOp>(
          [&](auto op) { return !facts.isInUnitInterval(op.getOperand(), op); })
      .Case<math::PowFOp, math::FPowIOp, math::AcoshOp, math::AtanhOp,
            math::CoshOp, math::SinhOp, arith::BitcastOp, vector::BitCastOp,
            InverseOp, SolveOp>([](auto) { return true; })
      .Default([](Operation *) { return false; });
}

bool FloatFacts::mayBeNonFinite(Value value) {
  auto [it, isNew] = nonFinite.try_emplace(value, false);
  if (!isNew)
    return it->second;
  size_t mark = concludedFinite.size();
  bool result = computeMayBeNonFinite(value);
  nonFinite[value] = result;
  if (!result) {
    concludedFinite.push_back(value);
  } else if (isa<BlockArgument>(value)) {
    // Until now the value was assumed to be finite, because a loop's value may
    // depend on itself. Facts concluded from this assumption are discarded.
    for (Value later : ArrayRef(concludedFinite).drop_front(mark))
      nonFinite.erase(later);
    concludedFinite.truncate(mark);
  }
  return result;
}

bool FloatFacts::computeMayBeNonFinite(Value value) {
  if (!isFloatOrVector(value.getType()))
    return false;
  if (auto argument = dyn_cast<BlockArgument>(value)) {
    Operation *parent = argument.getOwner()->getParentOp();
    if (auto loop = dyn_cast<scf::ForOp>(parent)) {
      unsigned index = argument.getArgNumber() - loop.getNumInductionVars();
      return mayBeNonFinite(loop.getInitArgs()[index]) ||
             mayBeNonFinite(loop.getYieldedValues()[index]);
    }
    return isa<LoopLikeOpInterface>(parent);
  }
  Operation *op = value.getDefiningOp();
  unsigned number = cast<OpResult>(value).getResultNumber();
  if (auto branch = dyn_cast<scf::IfOp>(op))
    return mayBeNonFinite(branch.thenYield().getOperand(number)) ||
           mayBeNonFinite(branch.elseYield().getOperand(number));
  if (auto loop = dyn_cast<scf::ForOp>(op))
    return mayBeNonFinite(loop.getRegionIterArg(number));
  if (op->getNumRegions() != 0)
    return true; // values arriving there are not looked into
  if (isPromisedFinite(op))
    return false;
  if (matchPattern(op, m_Constant()))
    return !matchConstant(value, [](const APFloat &x) { return x.isFinite(); });
  // A clamp bounds its result even if its operand is infinite. A NaN passes,
  // but it comes from an operand that is itself not finite.
  return makesNonFinite(op, *this) ||
         llvm::any_of(op->getOperands(),
                      [&](Value operand) { return mayBeNonFinite(operand); });
}

bool mlir::tai::mayHaveNonFinitePartial(Operation *op, FloatFacts &facts) {
  if (makesNonFinite(op, facts))
    return true;
  return llvm::TypeSwitch<Operation *, bool>(op)
      .Case<math::SqrtOp, math::CbrtOp>(
          [&](auto op) { return !facts.isPositive(op.getOperand(), op); })
      .Case<math::TanOp>([](auto) { return true; })
      .Case<math::AcosOp, math::AsinOp>([](auto) { return true; })
      .Case<math::Atan2Op>([](auto) { return false; })
      .Default([](Operation *) { return false; });
}
