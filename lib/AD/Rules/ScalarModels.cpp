//===- ScalarModels.cpp - The table behind the interface ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Lets the ops of arith and math find their row in the table of
// ScalarRules.cpp.
//
//===----------------------------------------------------------------------===//

#include "Models.h"
#include "ScalarRules.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "llvm/ADT/StringMap.h"

using namespace mlir;
using namespace mlir::tai;

static const ScalarRule &getRule(Operation *op) {
  static const llvm::StringMap<const ScalarRule *> rules = [] {
    llvm::StringMap<const ScalarRule *> map;
    for (const ScalarRule &rule : getScalarRules())
      map[rule.op] = &rule;
    return map;
  }();
  return *rules.at(op->getName().getStringRef());
}

static void applyRule(Operation *op, AdjointBuilder &adjoint) {
  Value seed = adjoint.getAdjoint(op->getResult(0));
  for (const Partial &partial : getRule(op).partials) {
    Value operand = op->getOperand(partial.operand);
    if (!adjoint.isActive(operand))
      continue;
    RuleArgs args(adjoint, op, seed);
    Value contribution = partial.build(args).value;
    if (args.usesNonFinite() || partial.mayBeNonFinite(args))
      contribution = adjoint.createGuard(seed, contribution);
    adjoint.addAdjoint(operand, contribution);
  }
}

namespace {
/// An op with a row in the table.
template <typename OpTy>
struct ScalarModel
    : DifferentiableOpInterface::ExternalModel<ScalarModel<OpTy>, OpTy> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &adjoint) const {
    applyRule(op, adjoint);
    return success();
  }
  bool carriesDerivative(Operation *op, OpOperand &operand) const {
    return llvm::any_of(getRule(op).partials, [&](const Partial &partial) {
      return partial.operand == operand.getOperandNumber();
    });
  }
};

/// Two results: sin x and cos x.
struct SincosModel
    : DifferentiableOpInterface::ExternalModel<SincosModel, math::SincosOp> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &b) const {
    auto sincos = cast<math::SincosOp>(op);
    if (Value g = b.getAdjoint(sincos.getSin()))
      b.addAdjoint(sincos.getOperand(),
                   arith::MulFOp::create(b, g, b.getPrimal(sincos.getCos())));
    if (Value g = b.getAdjoint(sincos.getCos()))
      b.addAdjoint(
          sincos.getOperand(),
          arith::NegFOp::create(
              b, arith::MulFOp::create(b, g, b.getPrimal(sincos.getSin()))));
    return success();
  }
};
} // namespace

template <typename... OpTy> static void attach(MLIRContext *context) {
  (OpTy::template attachInterface<ScalarModel<OpTy>>(*context), ...);
}

void mlir::tai::registerArithModels(DialectRegistry &registry) {
  registry.addExtension(+[](MLIRContext *context, arith::ArithDialect *) {
    attach<arith::AddFOp, arith::SubFOp, arith::NegFOp, arith::MulFOp,
           arith::DivFOp, arith::RemFOp, arith::SelectOp, arith::MaximumFOp,
           arith::MinimumFOp, arith::MaxNumFOp, arith::MinNumFOp, arith::ExtFOp,
           arith::TruncFOp, arith::FPToSIOp, arith::FPToUIOp, arith::CmpFOp>(
        context);
  });
}

void mlir::tai::registerMathModels(DialectRegistry &registry) {
  registry.addExtension(+[](MLIRContext *context, math::MathDialect *) {
    attach<math::FmaOp, math::ClampFOp, math::AbsFOp, math::CopySignOp,
           math::CeilOp, math::FloorOp, math::RoundOp, math::RoundEvenOp,
           math::TruncOp, math::IsFiniteOp, math::IsInfOp, math::IsNaNOp,
           math::IsNormalOp, math::SqrtOp, math::RsqrtOp, math::CbrtOp,
           math::ExpOp, math::Exp2Op, math::ExpM1Op, math::LogOp, math::Log2Op,
           math::Log10Op, math::Log1pOp, math::PowFOp, math::FPowIOp,
           math::SinOp, math::CosOp, math::TanOp, math::AsinOp, math::AcosOp,
           math::AtanOp, math::Atan2Op, math::SinhOp, math::CoshOp,
           math::TanhOp, math::AsinhOp, math::AcoshOp, math::AtanhOp,
           math::ErfOp, math::ErfcOp>(context);
    math::SincosOp::attachInterface<SincosModel>(*context);
  });
  registry.addExtension(
      +[](MLIRContext *context, math::MathDialect *, vector::VectorDialect *) {
        attach<vector::FMAOp>(context);
      });
}
