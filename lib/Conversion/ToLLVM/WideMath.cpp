//===- WideMath.cpp - Functions of f32 by arithmetic in f64 ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A call into libm prevents vectorisation, and computes one number at a time.
// In f64, exponentials and logarithms that are accurate for f32 need no table
// and no branch: the error of a short polynomial is 2^-35, so that the error
// after rounding to f32 is hardly more than half a unit in the last place
// (libm: up to 1, and 2 for tanh). Results are the same for scalars and
// vectors. Powers with exponents such as 1.5 are products with a square root.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/IR/Matchers.h"
#include "tai/Conversion/ToLLVM/FloatOptions.h"
#include "llvm/ADT/bit.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// Builds arithmetic on f64 or vectors of f64, which may be contracted.
class F64Builder {
public:
  /// `type`: the type of the operation to expand, f32 or a vector of f32.
  F64Builder(OpBuilder &builder, Location loc, Type type)
      : builder(builder), loc(loc), narrowType(type),
        wideType(withElement(builder.getF64Type())),
        bitsType(withElement(builder.getI64Type())),
        contract(arith::FastMathFlagsAttr::get(
            builder.getContext(), arith::FastMathFlags::contract)) {}

  Value constant(double value) {
    return splat(wideType, builder.getF64FloatAttr(value));
  }
  Value bits(int64_t value) {
    return splat(bitsType, builder.getI64IntegerAttr(value));
  }
  Value extend(Value a) {
    return arith::ExtFOp::create(builder, loc, wideType, a);
  }
  Value truncate(Value a) {
    return arith::TruncFOp::create(builder, loc, narrowType, a);
  }
  Value add(Value a, Value b) {
    return arith::AddFOp::create(builder, loc, a, b, contract);
  }
  Value sub(Value a, Value b) {
    return arith::SubFOp::create(builder, loc, a, b, contract);
  }
  Value mul(Value a, Value b) {
    return arith::MulFOp::create(builder, loc, a, b, contract);
  }
  Value div(Value a, Value b) {
    return arith::DivFOp::create(builder, loc, a, b, contract);
  }
  Value toBits(Value a) {
    return arith::BitcastOp::create(builder, loc, bitsType, a);
  }
  Value fromBits(Value a) {
    return arith::BitcastOp::create(builder, loc, wideType, a);
  }
  Value addBits(Value a, Value b) {
    return arith::AddIOp::create(builder, loc, a, b);
  }
  Value subBits(Value a, Value b) {
    return arith::SubIOp::create(builder, loc, a, b);
  }
  Value shiftLeft(Value a, int64_t by) {
    return arith::ShLIOp::create(builder, loc, a, bits(by));
  }
  Value shiftRight(Value a, int64_t by) {
    return arith::ShRSIOp::create(builder, loc, a, bits(by));
  }
  Value andBits(Value a, int64_t mask) {
    return arith::AndIOp::create(builder, loc, a, bits(mask));
  }
  Value squareRoot(Value a) { return math::SqrtOp::create(builder, loc, a); }
  Value absolute(Value a) { return math::AbsFOp::create(builder, loc, a); }
  Value toFloat(Value a) {
    return arith::SIToFPOp::create(builder, loc, wideType, a);
  }
  Value choose(arith::CmpFPredicate predicate, Value a, Value b, Value yes,
               Value no) {
    Value holds = arith::CmpFOp::create(builder, loc, predicate, a, b);
    return arith::SelectOp::create(builder, loc, holds, yes, no);
  }

  /// Emits c[0] + c[1] x + ... + c[7] x^7, with a short chain of dependent
  /// operations.
  Value polynomial(Value x, const std::array<double, 8> &c) {
    Value square = mul(x, x);
    Value fourth = mul(square, square);
    auto pair = [&](int i) {
      return add(constant(c[i]), mul(constant(c[i + 1]), x));
    };
    Value low = add(pair(0), mul(square, pair(2)));
    Value high = add(pair(4), mul(square, pair(6)));
    return add(low, mul(fourth, high));
  }

  /// Emits 2^k and e^r - 1, where x = k ln 2 + r, for |x| < 1000.
  std::pair<Value, Value> splitExp(Value x) {
    auto [k, scale] = roundToPower(mul(x, constant(0x1.71547652b82fep0)));
    return {scale, expm1OfSmall(sub(x, mul(k, constant(kLn2))))};
  }

  /// Emits 2^k and 2^r - 1, where x = k + r, for |x| < 1000.
  std::pair<Value, Value> splitExp2(Value x) {
    auto [k, scale] = roundToPower(x);
    return {scale, expm1OfSmall(mul(sub(x, k), constant(kLn2)))};
  }

private:
  static constexpr double kLn2 = 0x1.62e42fefa39efp-1;

  /// Emits the integer k nearest to x, and 2^k.
  std::pair<Value, Value> roundToPower(Value x) {
    // If this constant is added to a number below 2^51, the sum is rounded to
    // an integer, which is in its low bits.
    Value shifter = constant(0x1.8p52);
    Value shifted = add(x, shifter);
    Value scale = fromBits(
        addBits(shiftLeft(toBits(shifted), 52), bits(int64_t(1023) << 52)));
    return {sub(shifted, shifter), scale};
  }

  /// Emits e^r - 1 for |r| < 0.35.
  Value expm1OfSmall(Value r) {
    // The polynomial is (e^r - 1 - r) / r^2; its next term is below 2^-37.
    Value rest =
        polynomial(r, {1.0 / 2, 1.0 / 6, 1.0 / 24, 1.0 / 120, 1.0 / 720,
                       1.0 / 5040, 1.0 / 40320, 1.0 / 362880});
    return add(r, mul(mul(r, r), rest));
  }

  Type withElement(Type element) {
    auto vector = dyn_cast<VectorType>(narrowType);
    return vector ? Type(vector.clone(element)) : element;
  }
  Value splat(Type type, TypedAttr value) {
    if (auto vector = dyn_cast<VectorType>(type))
      value = DenseElementsAttr::get(vector, Attribute(value));
    return arith::ConstantOp::create(builder, loc, value);
  }

  OpBuilder &builder;
  Location loc;
  Type narrowType, wideType, bitsType;
  arith::FastMathFlagsAttr contract;
};

using Predicate = arith::CmpFPredicate;

/// Computes a power from the two factors that `split` returns. Beyond `lowest`
/// and `highest`, the f32 result is zero or infinity. NaN remains NaN.
Value expandPower(F64Builder &inF64, Value x, double lowest, double highest,
                  std::pair<Value, Value> (F64Builder::*split)(Value)) {
  Value most = inF64.constant(highest), least = inF64.constant(lowest);
  x = inF64.extend(x);
  x = inF64.choose(Predicate::OGT, x, most, most, x);
  x = inF64.choose(Predicate::OLT, x, least, least, x);
  auto [scale, minusOne] = (inF64.*split)(x);
  return inF64.truncate(inF64.add(scale, inF64.mul(scale, minusOne)));
}

Value expandExp(F64Builder &inF64, Value x) {
  return expandPower(inF64, x, -110, 90, &F64Builder::splitExp);
}
Value expandExp2(F64Builder &inF64, Value x) {
  return expandPower(inF64, x, -160, 130, &F64Builder::splitExp2);
}

/// Computes tanh x as t / (t + 2) with t = e^2x - 1, without cancellation.
Value expandTanh(F64Builder &inF64, Value x) {
  // From |x| = 9.1 on, tanh(x) rounds to 1 in f32, so 2 x is limited.
  Value most = inF64.constant(20);
  Value twice = inF64.extend(x);
  twice = inF64.add(twice, twice);
  twice = inF64.choose(Predicate::OGT, twice, most, most, twice);
  auto [scale, minusOne] = inF64.splitExp(twice);
  Value t = inF64.add(inF64.mul(scale, minusOne),
                      inF64.sub(scale, inF64.constant(1)));
  return inF64.truncate(inF64.div(t, inF64.add(t, inF64.constant(2))));
}

/// Computes log x as e ln 2 + ln m, where x = 2^e m, by the series of artanh((m
/// - 1) / (m + 1)). For another base, `ofTwo` replaces ln 2, and ln m is
/// multiplied by `scale`.
Value expandLog(F64Builder &inF64, Value narrow, double ofTwo, double scale) {
  Value x = inF64.extend(narrow);
  // Every f32 except 0 is a normal f64. After the bits of sqrt(1/2) are
  // subtracted, the exponent bits are e.
  constexpr auto rootHalf = int64_t(0x3fe6a09e667f3bcd);
  Value above = inF64.subBits(inF64.toBits(x), inF64.bits(rootHalf));
  Value e = inF64.toFloat(inF64.shiftRight(above, 52));
  Value m = inF64.fromBits(inF64.addBits(
      inF64.andBits(above, (int64_t(1) << 52) - 1), inF64.bits(rootHalf)));
  Value one = inF64.constant(1);
  Value s = inF64.div(inF64.sub(m, one), inF64.add(m, one));
  // As s^2 < 0.03, the first omitted term of the series is below 2^-40.
  Value series = inF64.polynomial(
      inF64.mul(s, s),
      {2.0, 2.0 / 3, 2.0 / 5, 2.0 / 7, 2.0 / 9, 2.0 / 11, 2.0 / 13, 2.0 / 15});
  if (scale != 1)
    s = inF64.mul(s, inF64.constant(scale));
  Value result =
      inF64.add(inF64.mul(e, inF64.constant(ofTwo)), inF64.mul(s, series));
  Value zero = inF64.constant(0);
  Value infinity = inF64.constant(std::numeric_limits<double>::infinity());
  Value nan = inF64.constant(std::numeric_limits<double>::quiet_NaN());
  result = inF64.choose(Predicate::OLT, x, infinity, result, x);
  result = inF64.choose(Predicate::OGT, x, zero, result, nan);
  result = inF64.choose(
      Predicate::OEQ, x, zero,
      inF64.constant(-std::numeric_limits<double>::infinity()), result);
  return inF64.truncate(result);
}

Value expandLogE(F64Builder &inF64, Value x) {
  return expandLog(inF64, x, /*ofTwo=*/0x1.62e42fefa39efp-1, /*scale=*/1);
}
Value expandLog2(F64Builder &inF64, Value x) {
  return expandLog(inF64, x, /*ofTwo=*/1, /*scale=*/0x1.71547652b82fep0);
}

template <typename Op, Value (*expand)(F64Builder &, Value), bool isOdd = false>
struct ExpandWide : OpRewritePattern<Op> {
  using OpRewritePattern<Op>::OpRewritePattern;
  LogicalResult matchAndRewrite(Op op,
                                PatternRewriter &rewriter) const override {
    Type type = op.getType();
    auto vector = dyn_cast<VectorType>(type);
    if (!getElementTypeOrSelf(type).isF32() || (vector && vector.isScalable()))
      return failure();
    Location loc = op.getLoc();
    F64Builder inF64(rewriter, loc, type);
    Value x = op.getOperand();
    // Odd functions are computed for |x|, and get the sign of x, which keeps
    // the sign of zero.
    if constexpr (isOdd)
      x = math::AbsFOp::create(rewriter, loc, x);
    Value result = expand(inF64, x);
    if constexpr (isOdd)
      result = math::CopySignOp::create(rewriter, loc, result, op.getOperand());
    rewriter.replaceOp(op, result);
    return success();
  }
};

/// The exponent of a power as a multiple of one half, if it is a constant and
/// an odd multiple of small magnitude.
std::optional<int> getHalves(math::PowFOp op) {
  llvm::APFloat exponent(0.0);
  if (!matchPattern(op.getRhs(), m_ConstantFloat(&exponent)))
    return std::nullopt;
  double halves = 2 * exponent.convertToDouble();
  for (int known : {-5, -3, -1, 3, 5})
    if (halves == known)
      return known;
  return std::nullopt;
}

/// Computes x^(halves / 2) of f32 in f64, in which neither a product nor an
/// inverse overflows.
Value expandHalves(F64Builder &inF64, Value narrow, int halves) {
  Value x = inF64.extend(narrow);
  Value power = inF64.squareRoot(x);
  for (int i = 1; i < std::abs(halves); i += 2)
    power = inF64.mul(power, x);
  // Powers of -0 are those of 0.
  power = inF64.absolute(power);
  Value infinity = inF64.constant(std::numeric_limits<double>::infinity());
  Value limit = infinity;
  if (halves < 0) {
    power = inF64.div(inF64.constant(1), power);
    limit = inF64.constant(0);
  }
  // The root of -infinity is NaN, and its powers are not.
  Value least = inF64.constant(-std::numeric_limits<double>::infinity());
  return inF64.truncate(inF64.choose(Predicate::OEQ, x, least, limit, power));
}

/// Computes x^(halves / 2) of f64, with the errors of the root and of the
/// products as a second number, so that the sum is hardly more than half a unit
/// in the last place off, or one unit where that number is too small for f64.
Value expandHalvesOfF64(OpBuilder &builder, Location loc, Value x, int halves) {
  Type type = x.getType();
  auto constant = [&](double value) -> Value {
    TypedAttr number = builder.getF64FloatAttr(value);
    if (auto vector = dyn_cast<VectorType>(type))
      number = DenseElementsAttr::get(vector, Attribute(number));
    return arith::ConstantOp::create(builder, loc, number);
  };
  // These operations must not be contracted.
  auto fma = [&](Value a, Value b, Value c) -> Value {
    return math::FmaOp::create(builder, loc, a, b, c);
  };
  auto mul = [&](Value a, Value b) -> Value {
    return arith::MulFOp::create(builder, loc, a, b);
  };
  auto negate = [&](Value a) -> Value {
    return arith::NegFOp::create(builder, loc, a);
  };
  Value high = math::SqrtOp::create(builder, loc, x);
  Value low =
      arith::DivFOp::create(builder, loc, fma(negate(high), high, x),
                            arith::AddFOp::create(builder, loc, high, high));
  for (int i = 1; i < halves; i += 2) {
    Value product = mul(high, x);
    low = arith::AddFOp::create(builder, loc, fma(high, x, negate(product)),
                                mul(low, x));
    high = product;
  }
  // The errors of zero and infinity are infinite or NaN.
  Value infinity = constant(std::numeric_limits<double>::infinity());
  auto compare = [&](Predicate predicate, Value a, Value b) -> Value {
    return arith::CmpFOp::create(builder, loc, predicate, a, b);
  };
  Value isRegular = compare(Predicate::OLT,
                            math::AbsFOp::create(builder, loc, low), infinity);
  Value sum = arith::AddFOp::create(builder, loc, high, low);
  Value power = arith::SelectOp::create(builder, loc, isRegular, sum, high);
  // Powers of -0 are those of 0, and the root of -infinity is NaN.
  power = math::AbsFOp::create(builder, loc, power);
  Value least = constant(-std::numeric_limits<double>::infinity());
  return arith::SelectOp::create(
      builder, loc, compare(Predicate::OEQ, x, least), infinity, power);
}

struct ExpandHalfPower : OpRewritePattern<math::PowFOp> {
  using OpRewritePattern::OpRewritePattern;
  LogicalResult matchAndRewrite(math::PowFOp op,
                                PatternRewriter &rewriter) const override {
    Type type = op.getType(), element = getElementTypeOrSelf(type);
    auto vector = dyn_cast<VectorType>(type);
    std::optional<int> halves = getHalves(op);
    if (!halves || (vector && vector.isScalable()))
      return failure();
    Location loc = op.getLoc();
    if (element.isF32()) {
      F64Builder inF64(rewriter, loc, type);
      rewriter.replaceOp(op, expandHalves(inF64, op.getLhs(), *halves));
      return success();
    }
    // An inverse would be zero where the power itself overflows.
    if (!element.isF64() || *halves < 0)
      return failure();
    rewriter.replaceOp(op,
                       expandHalvesOfF64(rewriter, loc, op.getLhs(), *halves));
    return success();
  }
};
} // namespace

void tai::populateWideMath(RewritePatternSet &patterns,
                           PatternBenefit benefit) {
  patterns.add<ExpandHalfPower>(patterns.getContext(), benefit);
  patterns.add<
      ExpandWide<math::ExpOp, expandExp>, ExpandWide<math::Exp2Op, expandExp2>,
      ExpandWide<math::LogOp, expandLogE>, ExpandWide<math::Log2Op, expandLog2>,
      ExpandWide<math::TanhOp, expandTanh, /*isOdd=*/true>>(
      patterns.getContext(), benefit);
}
