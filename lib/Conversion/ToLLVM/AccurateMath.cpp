//===- AccurateMath.cpp - Functions within one unit in the last place -----===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The libraries' functions of f32 are off by up to two units in the last place.
// Those of f64, rounded to f32, are off by hardly more than half of one. The
// exponential, the logarithm and the hyperbolic tangent of f32 are arithmetic
// in f64 already; see WideMath.cpp.
//
//===----------------------------------------------------------------------===//

#include "FloatOptions.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "tai/Dialect/Tai/IR/Modes.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// f(%x : f32)  ->  truncf (f (extf %x))
template <typename Op> struct ComputeInF64 : OpRewritePattern<Op> {
  using OpRewritePattern<Op>::OpRewritePattern;
  LogicalResult matchAndRewrite(Op op,
                                PatternRewriter &rewriter) const override {
    Type type = op.getType();
    if (!getElementTypeOrSelf(type).isF32() || !Modes::of(op).isAccurate())
      return failure();
    Type wide = rewriter.getF64Type();
    if (auto vector = dyn_cast<VectorType>(type))
      wide = vector.clone(wide);
    SmallVector<Value> operands;
    for (Value operand : op->getOperands())
      operands.push_back(
          arith::ExtFOp::create(rewriter, op.getLoc(), wide, operand));
    auto computed =
        Op::create(rewriter, op.getLoc(), wide, operands, op->getAttrs());
    rewriter.replaceOpWithNewOp<arith::TruncFOp>(op, type, computed);
    return success();
  }
};
} // namespace

void tai::populateAccurateMath(RewritePatternSet &patterns,
                               PatternBenefit benefit) {
  patterns.add<ComputeInF64<math::AcosOp>, ComputeInF64<math::AcoshOp>,
               ComputeInF64<math::AsinOp>, ComputeInF64<math::AsinhOp>,
               ComputeInF64<math::AtanOp>, ComputeInF64<math::Atan2Op>,
               ComputeInF64<math::AtanhOp>, ComputeInF64<math::CbrtOp>,
               ComputeInF64<math::CosOp>, ComputeInF64<math::CoshOp>,
               ComputeInF64<math::ErfOp>, ComputeInF64<math::ErfcOp>,
               ComputeInF64<math::ExpOp>, ComputeInF64<math::Exp2Op>,
               ComputeInF64<math::ExpM1Op>, ComputeInF64<math::LogOp>,
               ComputeInF64<math::Log10Op>, ComputeInF64<math::Log1pOp>,
               ComputeInF64<math::Log2Op>, ComputeInF64<math::PowFOp>,
               ComputeInF64<math::RsqrtOp>, ComputeInF64<math::SinOp>,
               ComputeInF64<math::SinhOp>, ComputeInF64<math::TanOp>,
               ComputeInF64<math::TanhOp>>(patterns.getContext(), benefit);
}
