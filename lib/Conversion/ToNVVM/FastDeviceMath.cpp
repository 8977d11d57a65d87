//===- FastDeviceMath.cpp - Approximate functions of a GPU ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The approximate instructions of a GPU have bounds on their errors for some
// arguments only (CUDA programming guide, "Intrinsic Functions"): sin.approx
// and cos.approx between -pi and pi, div.approx for divisors up to 2^126, and
// 2^(y log2 x) is NaN for negative x and for 0^0. The patterns here cost a few
// additions; their errors are some units for all arguments in use.
//
//===----------------------------------------------------------------------===//

#include "DeviceFloats.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/IR/PatternMatch.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// True if the operation computes a single f32 and may be approximated.
template <typename Op> bool isApproximate(Op op) {
  return op.getType().isF32() &&
         bitEnumContainsAll(op.getFastmath(), arith::FastMathFlags::afn);
}

/// Creates arithmetic without fast-math flags: the code relies on the order of
/// roundings.
class Exact {
public:
  Exact(OpBuilder &builder, Location loc) : builder(builder), loc(loc) {}

  Value constant(float value) {
    return arith::ConstantOp::create(builder, loc,
                                     builder.getF32FloatAttr(value));
  }
  Value mul(Value a, Value b) {
    return arith::MulFOp::create(builder, loc, a, b);
  }
  Value fma(Value a, Value b, Value c) {
    return LLVM::FMAOp::create(builder, loc, a.getType(), a, b, c);
  }
  Value compare(arith::CmpFPredicate predicate, Value a, Value b) {
    return arith::CmpFOp::create(builder, loc, predicate, a, b);
  }
  Value select(Value condition, Value a, Value b) {
    return arith::SelectOp::create(builder, loc, condition, a, b);
  }
  Value call(StringRef intrinsic, ValueRange operands) {
    return LLVM::CallIntrinsicOp::create(builder, loc, builder.getF32Type(),
                                         builder.getStringAttr(intrinsic),
                                         operands)
        .getResult(0);
  }

private:
  OpBuilder &builder;
  Location loc;
};

/// sin %x  ->  sin.approx (%x - 2 pi round(%x / 2 pi)), and cos likewise
///
/// 2 pi is subtracted in three parts, so that the rest of an argument of some
/// thousands of periods is right to an ulp of 2 pi (Cody and Waite).
template <typename Op, typename Intrinsic>
struct ReduceFirst : OpRewritePattern<Op> {
  using OpRewritePattern<Op>::OpRewritePattern;
  LogicalResult matchAndRewrite(Op op,
                                PatternRewriter &rewriter) const override {
    if (!isApproximate(op))
      return failure();
    Exact exact(rewriter, op.getLoc());
    Value x = op.getOperand();
    Value periods = exact.mul(x, exact.constant(0.15915494309189535f));
    periods = LLVM::RoundEvenOp::create(rewriter, op.getLoc(),
                                        periods.getType(), periods);
    for (float part : {6.28125f, 1.9350051879882812e-3f, 3.0199160e-7f})
      x = exact.fma(periods, exact.constant(-part), x);
    // The flag afn makes the NVPTX backend select the approximate instruction.
    rewriter.replaceOp(op, Intrinsic::create(rewriter, op.getLoc(), x,
                                             LLVM::FastmathFlags::afn));
    return success();
  }
};

/// powf %x, %y  ->  2^(%y log2 |%x|), with IEEE 754's signs and special cases
struct PowerOfAny : OpRewritePattern<math::PowFOp> {
  using OpRewritePattern::OpRewritePattern;
  LogicalResult matchAndRewrite(math::PowFOp op,
                                PatternRewriter &rewriter) const override {
    if (!isApproximate(op))
      return failure();
    Location loc = op.getLoc();
    Exact exact(rewriter, loc);
    Value x = op.getLhs(), y = op.getRhs();
    Value zero = exact.constant(0), one = exact.constant(1);
    Value size = LLVM::FAbsOp::create(rewriter, loc, x.getType(), x);
    Value log = exact.call("llvm.nvvm.lg2.approx.f", size);
    Value power = exact.call("llvm.nvvm.ex2.approx", exact.mul(y, log));
    // A negative base has real powers only for integers; odd ones are negative.
    auto isWhole = [&](Value value) {
      Value whole = math::TruncOp::create(rewriter, loc, value);
      return exact.compare(arith::CmpFPredicate::OEQ, whole, value);
    };
    Value isEven = isWhole(exact.mul(y, exact.constant(0.5f)));
    Value minus = arith::NegFOp::create(rewriter, loc, power);
    Value nan = arith::ConstantOp::create(
        rewriter, loc,
        rewriter.getFloatAttr(rewriter.getF32Type(),
                              APFloat::getNaN(APFloat::IEEEsingle())));
    Value signed_ = exact.select(isEven, power, minus);
    Value ofNegative = exact.select(isWhole(y), signed_, nan);
    Value isNegative = exact.compare(arith::CmpFPredicate::OLT, x, zero);
    Value result = exact.select(isNegative, ofNegative, power);
    // 1^y and x^0 are 1, also where the exponent is 0 * inf or x is NaN.
    Value isOne = arith::OrIOp::create(
        rewriter, loc, exact.compare(arith::CmpFPredicate::OEQ, x, one),
        exact.compare(arith::CmpFPredicate::OEQ, y, zero));
    rewriter.replaceOp(op, exact.select(isOne, one, result));
    return success();
  }
};

/// divf %x, %y  ->  div.full, with an error of two units for all %y
///
/// Several quotients with one divisor are left to the backend, which multiplies
/// by the reciprocal of the divisor; so are reciprocals, for which it has an
/// instruction, and quotients of or by constants.
struct FullQuotient : OpRewritePattern<arith::DivFOp> {
  using OpRewritePattern::OpRewritePattern;
  LogicalResult matchAndRewrite(arith::DivFOp op,
                                PatternRewriter &rewriter) const override {
    if (!isApproximate(op) || op.getRhs().getDefiningOp<arith::ConstantOp>() ||
        op.getLhs().getDefiningOp<arith::ConstantOp>())
      return failure();
    auto divides = [&](OpOperand &use) {
      return use.getOperandNumber() == 1 && isa<arith::DivFOp>(use.getOwner());
    };
    if (llvm::count_if(op.getRhs().getUses(), divides) != 1)
      return failure();
    Exact exact(rewriter, op.getLoc());
    rewriter.replaceOp(op, exact.call("llvm.nvvm.div.full", op.getOperands()));
    return success();
  }
};
} // namespace

void tai::populateFastDeviceMath(RewritePatternSet &patterns,
                                 unsigned benefit) {
  patterns.add<ReduceFirst<math::SinOp, LLVM::SinOp>,
               ReduceFirst<math::CosOp, LLVM::CosOp>, PowerOfAny, FullQuotient>(
      patterns.getContext(), benefit);
}
