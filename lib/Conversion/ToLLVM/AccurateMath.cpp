//===- AccurateMath.cpp - Functions within one unit in the last place -----===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The f32 functions of libraries have errors of up to two units in the last
// place. The f64 functions, rounded to f32, have errors of hardly more than
// half a unit. Exponential, logarithm and hyperbolic tangent of f32 are
// arithmetic in f64 already; see WideMath.cpp. f64 functions whose library
// version is off by more than one unit are computed in a wider float.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "tai/Conversion/ToLLVM/FloatOptions.h"
#include "tai/Dialect/Tai/IR/Modes.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// Computes a function of f32 in f64: f(%x : f32)  ->  truncf (f (extf %x))
template <typename Op> struct ComputeInF64 : OpRewritePattern<Op> {
  using OpRewritePattern<Op>::OpRewritePattern;
  LogicalResult matchAndRewrite(Op op,
                                PatternRewriter &rewriter) const override {
    Type type = op.getType();
    if (!getElementTypeOrSelf(type).isF32() || !Modes::of(op).isAccurate())
      return failure();
    Type larger = rewriter.getF64Type();
    if (auto vector = dyn_cast<VectorType>(type))
      larger = vector.clone(larger);
    SmallVector<Value> operands;
    for (Value operand : op->getOperands())
      operands.push_back(
          arith::ExtFOp::create(rewriter, op.getLoc(), larger, operand));
    Value computed;
    if constexpr (std::is_same_v<Op, math::RsqrtOp>) {
      Value root = math::SqrtOp::create(rewriter, op.getLoc(), operands[0]);
      Attribute one = rewriter.getFloatAttr(rewriter.getF64Type(), 1.0);
      if (auto vector = dyn_cast<VectorType>(larger))
        one = DenseElementsAttr::get(vector, one);
      computed =
          arith::DivFOp::create(rewriter, op.getLoc(),
                                arith::ConstantOp::create(rewriter, op.getLoc(),
                                                          cast<TypedAttr>(one)),
                                root);
    } else {
      computed =
          Op::create(rewriter, op.getLoc(), larger, operands, op->getAttrs());
    }
    rewriter.replaceOpWithNewOp<arith::TruncFOp>(op, type, computed);
    return success();
  }
};
/// Returns a float type that is wider than f64: f80 on x86-64, elsewhere f128
/// in software.
FloatType getExtendedType(MLIRContext *context) {
#if defined(__x86_64__)
  return Float80Type::get(context);
#else
  return Float128Type::get(context);
#endif
}

/// Computes a function of one f64 in a wider float type.
template <typename Op> struct ComputeExtended : OpRewritePattern<Op> {
  using OpRewritePattern<Op>::OpRewritePattern;
  LogicalResult matchAndRewrite(Op op,
                                PatternRewriter &rewriter) const override {
    Type type = op.getType();
    if (!type.isF64() || !Modes::of(op).isAccurate())
      return failure();
    Location loc = op.getLoc();
    FloatType larger = getExtendedType(rewriter.getContext());
    Value x = LLVM::FPExtOp::create(rewriter, loc, larger, op.getOperand());
    rewriter.replaceOpWithNewOp<LLVM::FPTruncOp>(op, type,
                                                 compute(rewriter, loc, x));
    return success();
  }
  virtual Value compute(PatternRewriter &rewriter, Location loc,
                        Value x) const = 0;
};

/// In f64, 1 / sqrt(x) is rounded twice, with an error of up to 1.5 units.
struct ExtendedRsqrt : ComputeExtended<math::RsqrtOp> {
  using ComputeExtended::ComputeExtended;
  Value compute(PatternRewriter &rewriter, Location loc,
                Value x) const override {
    Type type = x.getType();
    Value root = LLVM::SqrtOp::create(rewriter, loc, x);
    Value one = LLVM::ConstantOp::create(rewriter, loc, type,
                                         rewriter.getFloatAttr(type, 1.0));
    return LLVM::FDivOp::create(rewriter, loc, one, root);
  }
};

/// Computes in a wider float type those functions of libm whose error exceeds
/// one unit: tanh 1.7, log10 1.5, cbrt 3 units.
template <typename Op> struct ExtendedCall : ComputeExtended<Op> {
  ExtendedCall(MLIRContext *context, PatternBenefit benefit, StringRef name)
      : ComputeExtended<Op>(context, benefit), name(name) {}
  Value compute(PatternRewriter &rewriter, Location loc,
                Value x) const override {
    Operation *table =
        SymbolTable::getNearestSymbolTable(x.getDefiningOp()->getParentOp());
    Operation *function = SymbolTable::lookupSymbolIn(table, name);
    if (!function) {
      OpBuilder::InsertionGuard guard(rewriter);
      rewriter.setInsertionPointToStart(&table->getRegion(0).front());
      auto type = LLVM::LLVMFunctionType::get(x.getType(), {x.getType()});
      function = LLVM::LLVMFuncOp::create(rewriter, loc, name, type);
    }
    return LLVM::CallOp::create(rewriter, loc, cast<LLVM::LLVMFuncOp>(function),
                                x)
        .getResult();
  }
  StringRef name;
};
} // namespace

void tai::populateAccurateMath(RewritePatternSet &patterns,
                               PatternBenefit benefit, bool onDevice) {
  if (!onDevice) {
    MLIRContext *context = patterns.getContext();
    patterns.add<ExtendedRsqrt>(context, benefit);
    patterns.add<ExtendedCall<math::TanhOp>>(context, benefit, "tanhl");
    patterns.add<ExtendedCall<math::SinhOp>>(context, benefit, "sinhl");
    patterns.add<ExtendedCall<math::CoshOp>>(context, benefit, "coshl");
    patterns.add<ExtendedCall<math::AsinhOp>>(context, benefit, "asinhl");
    patterns.add<ExtendedCall<math::AcoshOp>>(context, benefit, "acoshl");
    patterns.add<ExtendedCall<math::AtanhOp>>(context, benefit, "atanhl");
    patterns.add<ExtendedCall<math::CbrtOp>>(context, benefit, "cbrtl");
    patterns.add<ExtendedCall<math::Log10Op>>(context, benefit, "log10l");
    patterns.add<ExtendedCall<math::ErfOp>>(context, benefit, "erfl");
    patterns.add<ExtendedCall<math::ErfcOp>>(context, benefit, "erfcl");
  }
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
