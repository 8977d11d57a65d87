//===- ScalarRules.cpp - The table of derivatives -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// One row for each differentiable scalar op: the op, the partials by operand,
// and the values at kinks. docs/reference/derivatives.md shows the same table;
// a test compares the two.
//
// A partial has a guard (a zero adjoint contributes zero, whatever the partial
// is) unless it is finite: see `Partial::mayBeNonFinite`.
//
//===----------------------------------------------------------------------===//

#include "ScalarRules.h"
#include "mlir/IR/Matchers.h"
#include "tai/AD/NarrowAdjoints.h"

using namespace mlir;
using namespace mlir::tai;

Num RuleArgs::cast(Num a, unsigned i) {
  Value target =
      mode == Mode::Backward ? op->getOperand(i) : Value(op->getResult(0));
  return {a.builder, createCastOfAdjoint(builder, builder.getLoc(), a.value,
                                         target.getType())};
}

//===----------------------------------------------------------------------===//
// Tests whether a partial derivative may be infinite or NaN
//===----------------------------------------------------------------------===//

static Value operand(RuleArgs &a, unsigned i) {
  return a.getOperation()->getOperand(i);
}
static bool never(RuleArgs &) { return false; }
static bool always(RuleArgs &) { return true; }
static bool unlessXPositive(RuleArgs &a) {
  return !a.facts().isPositive(operand(a, 0), a.getOperation());
}
static bool unlessXNonNegative(RuleArgs &a) {
  return !a.facts().isNonNegative(operand(a, 0), a.getOperation());
}
static bool unlessXNonPositive(RuleArgs &a) {
  return !a.facts().isNonPositive(operand(a, 0), a.getOperation());
}
static bool unlessYNonZero(RuleArgs &a) {
  Value y = a.getOperand(1);
  return y && !a.facts().isNonZero(y, a.getOperation());
}
/// False if y is a constant of at least 1: then x^(y - 1) is finite for finite
/// x.
static bool unlessYAtLeastOne(RuleArgs &a) {
  APFloat number(0.0f);
  APInt integer;
  Value y = operand(a, 1);
  if (matchPattern(y, m_ConstantFloat(&number)))
    return number < APFloat(number.getSemantics(), 1);
  if (matchPattern(y, m_ConstantInt(&integer)))
    return integer.slt(1);
  return true;
}

//===----------------------------------------------------------------------===//
// Functions that formulas use
//===----------------------------------------------------------------------===//

static Num sin(Num a) { return make<math::SinOp>(a); }
static Num cos(Num a) { return make<math::CosOp>(a); }
static Num sinh(Num a) { return make<math::SinhOp>(a); }
static Num cosh(Num a) { return make<math::CoshOp>(a); }
static Num exp(Num a) { return make<math::ExpOp>(a); }
static Num log(Num a) { return make<math::LogOp>(a); }
static Num sqrt(Num a) { return make<math::SqrtOp>(a); }
static Num round(Num a) { return make<math::RoundEvenOp>(a); }
static Num pow(Num a, Num b) { return make<math::PowFOp>(a, b); }
static Num copysign(Num a, Num b) { return make<math::CopySignOp>(a, b); }

/// Returns g with the sign of x: g for x > 0, -g for x < 0, and 0 at x = 0.
static Num bySign(Num x, Num g) { return select(x > 0, g, where(x < 0, -g)); }

/// Returns the contribution to the first operand of max or min, which is chosen
/// where `wins` holds. In a tie the contribution goes to the second operand, or
/// half to each operand if the convention splits ties.
static Num toFirst(RuleArgs &a, Truth wins) {
  if (!a.getConventions().splitTies)
    return where(wins, a.g());
  return select(wins, a.g(), where(a.x() == a.y(), 0.5 * a.g()));
}
static Num toSecond(RuleArgs &a, Truth wins) {
  if (!a.getConventions().splitTies)
    return unless(wins, a.g());
  return unless(wins, select(a.x() == a.y(), 0.5 * a.g(), a.g()));
}

/// Emits sqrt(1 - x^2), the reciprocal of the slope of asin.
static Num arcSlope(RuleArgs &a) {
  Num x = a.x();
  if (!a.getConventions().clampArcs)
    return sqrt((1 - x) * (1 + x));
  // At ±1 the slope is that of the nearest number inside (-1, 1), where 1 - x^2
  // is about 2 (1 - inside).
  const llvm::fltSemantics &semantics =
      cast<FloatType>(getElementTypeOrSelf(x.value.getType()))
          .getFloatSemantics();
  APFloat inside(semantics, 1);
  inside.next(/*nextDown=*/true);
  double least = 2 * (1 - inside.convertToDouble());
  Num square = (1 - x) * (1 + x);
  return sqrt(select(square < constant(x, least), constant(x, least), square));
}

/// Returns the square root of `square`, which is x^2 + 1 or x^2 - 1. For large
/// x the result is |x|, which is correct to the last bit, also where the square
/// overflows.
static Num rootBeside(Num x, Num square) {
  Num size = make<math::AbsFOp>(x);
  return select(size > 0x1p+30, size, sqrt(square));
}

/// Returns n x^(n - 1) for an integer n; 0 where n = 0.
static Num powerByInteger(RuleArgs &a) {
  DerivativeBuilder &b = *a.g().builder;
  Value n = a.truth(1).value;
  Type element = getElementTypeOrSelf(n.getType());
  TypedAttr oneAttr = b.getIntegerAttr(element, 1);
  TypedAttr zeroAttr = b.getIntegerAttr(element, 0);
  if (auto vector = dyn_cast<VectorType>(n.getType())) {
    oneAttr = DenseElementsAttr::get(vector, Attribute(oneAttr));
    zeroAttr = DenseElementsAttr::get(vector, Attribute(zeroAttr));
  }
  Value one = arith::ConstantOp::create(b, oneAttr);
  Value zero = arith::ConstantOp::create(b, zeroAttr);
  Num x = a.x();
  Value less = b.createOrFold<arith::SubIOp>(n, one);
  Num power = {&b, math::FPowIOp::create(b, x.value, less)};
  Num factor = {&b, arith::SIToFPOp::create(b, x.value.getType(), n)};
  Truth isZero = {&b,
                  arith::CmpIOp::create(b, arith::CmpIPredicate::eq, n, zero)};
  return unless(isZero, factor * power);
}

static Num powerByX(RuleArgs &a) {
  Num contribution = a.g() * (a.y() * pow(a.x(), a.y() - 1));
  return a.facts().isNonZero(operand(a, 1), a.getOperation())
             ? contribution
             : unless(a.y() == 0, contribution);
}

/// Returns the contribution to an operand of atan2(y, x): g n / (x^2 + y^2)
/// with n = y or -x; 0 where x and y are both 0 or one of them is infinite. x
/// and y are scaled by a power of two where their squares would overflow or
/// underflow.
static Num atan2By(RuleArgs &a, bool byX) {
  Num x = a.x(), y = a.y();
  bool isDouble = getElementTypeOrSelf(x.value.getType()).isF64();
  double exponent = isDouble ? 480 : 50, factor = isDouble ? 600 : 100;
  Num size =
      make<arith::MaximumFOp>(make<math::AbsFOp>(x), make<math::AbsFOp>(y));
  Num by = select(size < std::exp2(-exponent), constant(x, std::exp2(factor)),
                  select(size > std::exp2(exponent),
                         constant(x, std::exp2(-factor)), constant(x, 1)));
  x = x * by, y = y * by;
  Num square = x * x + y * y;
  double infinity = std::numeric_limits<double>::infinity();
  return unless(square == 0 || size == infinity,
                a.g() * ((byX ? y : -x) / square) * by);
}

using A = RuleArgs &;
static const double kLn2 = 0.693147180559945309417232121458;
static const double kLn10 = 2.302585092994045684017991454684;
static const double kTwoBySqrtPi = 1.128379167095512573896158903122;

//===----------------------------------------------------------------------===//
// The table
//===----------------------------------------------------------------------===//

ArrayRef<ScalarRule> mlir::tai::getScalarRules() {
  // clang-format off
  static const ScalarRule rules[] = {
    // Sums and products
    {"arith.addf", {{0, "g", never, [](A a) { return a.g(); }},
                    {1, "g", never, [](A a) { return a.g(); }}}},
    {"arith.subf", {{0, "g", never, [](A a) { return a.g(); }},
                    {1, "-g", never, [](A a) { return -a.g(); }}}},
    {"arith.negf", {{0, "-g", never, [](A a) { return -a.g(); }}}},
    {"arith.mulf", {{0, "g y", never, [](A a) { return a.g() * a.y(); }},
                    {1, "g x", never, [](A a) { return a.g() * a.x(); }}}},
    {"arith.divf", {{0, "g / y", unlessYNonZero, [](A a) { return a.g() / a.y(); }},
                    {1, "-(g / y) r", unlessYNonZero, [](A a) { return -(a.g() / a.y() * a.r()); }}}},
    {"arith.remf", {{0, "g", never, [](A a) { return a.g(); }},
                    {1, "-g round((x - r) / y)", unlessYNonZero, [](A a) { return -(a.g() * round((a.x() - a.r()) / a.y())); }}},
     "at a multiple of y: as just above it"},
    {"math.fma", {{0, "g y", never, [](A a) { return a.g() * a.y(); }},
                  {1, "g x", never, [](A a) { return a.g() * a.x(); }},
                  {2, "g", never, [](A a) { return a.g(); }}}},
    {"vector.fma", {{0, "g y", never, [](A a) { return a.g() * a.y(); }},
                    {1, "g x", never, [](A a) { return a.g() * a.x(); }},
                    {2, "g", never, [](A a) { return a.g(); }}}},

    // Choices
    {"arith.select", {{1, "g where x", never, [](A a) { return where(a.truth(0), a.g()); }},
                      {2, "g unless x", never, [](A a) { return unless(a.truth(0), a.g()); }}},
     "the arm not taken gets 0"},
    {"arith.maximumf", {{0, "g where x > y", never, [](A a) { return toFirst(a, a.x() > a.y()); }},
                        {1, "g unless x > y", never, [](A a) { return toSecond(a, a.x() > a.y()); }}},
     "a tie: y gets all, or each half with `ties = split`"},
    {"arith.minimumf", {{0, "g where x < y", never, [](A a) { return toFirst(a, a.x() < a.y()); }},
                        {1, "g unless x < y", never, [](A a) { return toSecond(a, a.x() < a.y()); }}},
     "a tie: y gets all, or each half with `ties = split`"},
    {"arith.maxnumf", {{0, "g where x > y", never, [](A a) { return toFirst(a, a.x() > a.y() || isNaN(a.y())); }},
                       {1, "g unless x > y", never, [](A a) { return toSecond(a, a.x() > a.y() || isNaN(a.y())); }}},
     "a tie: y gets all, or each half with `ties = split`; NaN: the number gets all"},
    {"arith.minnumf", {{0, "g where x < y", never, [](A a) { return toFirst(a, a.x() < a.y() || isNaN(a.y())); }},
                       {1, "g unless x < y", never, [](A a) { return toSecond(a, a.x() < a.y() || isNaN(a.y())); }}},
     "a tie: y gets all, or each half with `ties = split`; NaN: the number gets all"},
    {"math.clampf", {{0, "g where y <= x <= z", never, [](A a) { return unless(a.x() < a.y() || a.x() > a.z(), a.g()); }},
                     {1, "g where x < y", never, [](A a) { return where(a.x() < a.y(), a.g()); }},
                     {2, "g where x > z", never, [](A a) { return where(a.x() > a.z(), a.g()); }}},
     "at either edge: x gets all"},
    {"math.absf", {{0, "g sign x", never, [](A a) { return bySign(a.x(), a.g()); }}},
     "x = 0: 0"},
    {"math.copysign", {{0, "g sign x sign y", never,
                        [](A a) { return bySign(a.x(), a.g() * copysign(constant(a.g(), 1), a.y())); }}},
     "x = 0: 0; by y: 0"},

    // Casts and rounding
    {"arith.extf", {{0, "g", never, [](A a) { return a.cast(a.g(), 0); }}}},
    {"arith.truncf", {{0, "g", never, [](A a) { return a.cast(a.g(), 0); }}}},
    {"arith.fptosi", {}, "0 everywhere"},
    {"arith.fptoui", {}, "0 everywhere"},
    {"arith.cmpf", {}, "0 everywhere"},
    {"math.ceil", {}, "0 everywhere"},
    {"math.floor", {}, "0 everywhere"},
    {"math.round", {}, "0 everywhere"},
    {"math.roundeven", {}, "0 everywhere"},
    {"math.trunc", {}, "0 everywhere"},
    {"math.isfinite", {}, "0 everywhere"},
    {"math.isinf", {}, "0 everywhere"},
    {"math.isnan", {}, "0 everywhere"},
    {"math.isnormal", {}, "0 everywhere"},

    // Powers and logarithms
    {"math.sqrt", {{0, "g / (2 r)", unlessXPositive, [](A a) { return a.g() / (a.r() + a.r()); }}},
     "x = 0: infinite, or 0 where g = 0"},
    {"math.rsqrt", {{0, "-g r^3 / 2", unlessXPositive, [](A a) { return -0.5 * a.g() * a.r() * a.r() * a.r(); }}},
     "x = 0: infinite, or 0 where g = 0"},
    {"math.cbrt", {{0, "g / (3 r^2)", unlessXPositive, [](A a) { return a.g() / (3 * (a.r() * a.r())); }}},
     "x = 0: infinite, or 0 where g = 0"},
    {"math.exp", {{0, "g r", never, [](A a) { return a.g() * a.r(); }}}},
    {"math.exp2", {{0, "g r ln 2", never, [](A a) { return kLn2 * (a.g() * a.r()); }}}},
    {"math.expm1", {{0, "g exp(x)", unlessXNonPositive, [](A a) { return a.g() * exp(a.x()); }}}},
    {"math.log", {{0, "g / x", unlessXPositive, [](A a) { return a.g() / a.x(); }}},
     "x = 0: infinite, or 0 where g = 0"},
    {"math.log2", {{0, "g / (x ln 2)", unlessXPositive, [](A a) { return a.g() / (kLn2 * a.x()); }}},
     "x = 0: infinite, or 0 where g = 0"},
    {"math.log10", {{0, "g / (x ln 10)", unlessXPositive, [](A a) { return a.g() / (kLn10 * a.x()); }}},
     "x = 0: infinite, or 0 where g = 0"},
    {"math.log1p", {{0, "g / (1 + x)", unlessXNonNegative, [](A a) { return a.g() / (1 + a.x()); }}},
     "x = -1: infinite, or 0 where g = 0"},
    {"math.powf", {{0, "g y x^(y - 1)", unlessYAtLeastOne, powerByX},
                   {1, "g r log x", always, [](A a) { return unless(a.x() == 0, a.g() * a.r() * log(a.x())); }}},
     "y = 0: 0 by x; x = 0: 0 by y; x < 0: exact by x, NaN by y"},
    {"math.fpowi", {{0, "g y x^(y - 1)", unlessYAtLeastOne, [](A a) { return a.g() * powerByInteger(a); }}},
     "y = 0: 0"},

    // Trigonometry
    {"math.sin", {{0, "g cos x", never, [](A a) { return a.g() * cos(a.x()); }}}},
    {"math.cos", {{0, "-g sin x", never, [](A a) { return -(a.g() * sin(a.x())); }}}},
    {"math.tan", {{0, "g (1 + r^2)", never, [](A a) { return a.g() * (1 + a.r() * a.r()); }}}},
    {"math.asin", {{0, "g / sqrt((1 - x)(1 + x))", always, [](A a) { return a.g() / arcSlope(a); }}},
     "x = ±1: infinite, or 0 where g = 0; with `arcs = clamp` as at the next number inside"},
    {"math.acos", {{0, "-g / sqrt((1 - x)(1 + x))", always, [](A a) { return -(a.g() / arcSlope(a)); }}},
     "x = ±1: infinite, or 0 where g = 0; with `arcs = clamp` as at the next number inside"},
    {"math.atan", {{0, "g / (1 + x^2)", never, [](A a) { return a.g() / (1 + a.x() * a.x()); }}}},
    {"math.atan2", {{0, "g y / (x^2 + y^2)", never, [](A a) { return atan2By(a, true); }},
                    {1, "-g x / (x^2 + y^2)", never, [](A a) { return atan2By(a, false); }}},
     "x = y = 0: 0, 0"},

    // Hyperbolic functions
    {"math.sinh", {{0, "g cosh x", always, [](A a) { return a.g() * cosh(a.x()); }}}},
    {"math.cosh", {{0, "g sinh x", always, [](A a) { return a.g() * sinh(a.x()); }}}},
    {"math.tanh", {{0, "g (1 - r)(1 + r)", never, [](A a) { return a.g() * ((1 - a.r()) * (1 + a.r())); }}}},
    {"math.asinh", {{0, "g / sqrt(1 + x^2)", never, [](A a) { return a.g() / rootBeside(a.x(), 1 + a.x() * a.x()); }}}},
    {"math.acosh", {{0, "g / sqrt((x - 1)(x + 1))", always, [](A a) { return a.g() / rootBeside(a.x(), (a.x() - 1) * (1 + a.x())); }}},
     "x = 1: infinite, or 0 where g = 0"},
    {"math.atanh", {{0, "g / ((1 - x)(1 + x))", always, [](A a) { return a.g() / ((1 - a.x()) * (1 + a.x())); }}},
     "x = ±1: infinite, or 0 where g = 0"},

    // Error functions
    {"math.erf", {{0, "2/sqrt(pi) g exp(-x^2)", never, [](A a) { return kTwoBySqrtPi * (a.g() * exp(-(a.x() * a.x()))); }}}},
    {"math.erfc", {{0, "-2/sqrt(pi) g exp(-x^2)", never, [](A a) { return -kTwoBySqrtPi * (a.g() * exp(-(a.x() * a.x()))); }}}},
  };
  // clang-format on
  return rules;
}
