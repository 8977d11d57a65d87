//===- ScalarModels.cpp - Interface models from the table -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// External models that implement the interface for ops of arith and math by
// their row in the table of ScalarRules.cpp.
//
//===----------------------------------------------------------------------===//

#include "Models.h"
#include "ScalarRules.h"
#include "SharedFactors.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/Matchers.h"
#include "tai/AD/Reverse/AdjointBuilder.h"
#include "tai/Analysis/ZeroTests.h"
#include "tai/Dialect/Tai/IR/Tai.h"
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

/// Builds the contribution of one partial derivative. If both operands have a
/// shared factor, the op is differentiated by their cofactors; where the shared
/// factor is zero, the contribution of atan2 is zero.
static Value build(const Partial &partial, RuleArgs &args,
                   const std::optional<SharedFactor> &shared) {
  if (!shared)
    return partial.build(args).value;
  args.setOperands(shared->rest);
  Num product = partial.build(args);
  if (!isa<math::Atan2Op>(args.getOperation()))
    return product.value;
  Num factor{product.builder, product.builder->getPrimal(shared->factor)};
  return unless(factor == 0, product).value;
}

static void applyRule(Operation *op, AdjointBuilder &adjoint) {
  Value seed = adjoint.getAdjoint(op->getResult(0));
  std::optional<SharedFactor> shared = findFactorOfRatio(op);
  for (const Partial &partial : getRule(op).partials) {
    Value operand = shared ? shared->rest[partial.operand]
                           : op->getOperand(partial.operand);
    if (!operand || !adjoint.isActive(operand))
      continue;
    RuleArgs args(adjoint, op, seed);
    Value contribution = build(partial, args, shared);
    // Where the partial derivative is zero, an undefined (NaN) adjoint
    // contributes zero.
    if (adjoint.isSeedUndefined()) {
      RuleArgs unit(adjoint, op, adjoint.createConstant(seed.getType(), 1));
      Value slope = build(partial, unit, shared);
      if (!matchPattern(slope, m_Constant()))
        contribution = adjoint.createGuard(slope, contribution);
    }
    if (args.usesNonFinite() || partial.mayBeNonFinite(args)) {
      contribution = adjoint.createGuard(seed, contribution);
      if (adjoint.wantsGuards())
        adjoint.markInfinite(operand);
    }
    // The derivative of pow by the exponent is the only derivative that may not
    // exist where the value is finite.
    if (isa<math::PowFOp>(op) && partial.operand == 1 &&
        adjoint.wantsGuards() &&
        !adjoint.getFacts().isNonNegative(op->getOperand(0), op))
      adjoint.markUndefined(operand);
    adjoint.addAdjoint(operand, contribution);
  }
}

/// True for functions whose value is finite where the operand is infinite. The
/// tangent of such an operand may overflow, too, although all values that the
/// program reads are finite; the partial is zero there.
static bool saturates(Operation *op, unsigned operand) {
  return isa<math::ExpOp, math::Exp2Op, math::TanhOp, math::AtanOp,
             math::Atan2Op, math::ErfOp, math::ErfcOp, math::RsqrtOp>(op) ||
         (isa<arith::DivFOp>(op) && operand == 1);
}

static void applyTangentRule(Operation *op, TangentBuilder &b) {
  if (extendSharedSum(op, b))
    return;
  std::optional<SharedFactor> shared = findFactorOfRatio(op);
  Value sum;
  for (const Partial &partial : getRule(op).partials) {
    Value operand = shared ? shared->rest[partial.operand]
                           : op->getOperand(partial.operand);
    Value tangent = operand ? b.getTangent(operand) : Value();
    if (!tangent)
      continue;
    RuleArgs args(b, op, tangent, RuleArgs::Mode::Forward);
    Value product = build(partial, args, shared);
    auto createSlope = [&] {
      Value one = b.createConstant(tangent.getType(), 1);
      RuleArgs unit(b, op, one, RuleArgs::Mode::Forward);
      return build(partial, unit, shared);
    };
    Value term = b.createProduct(
        operand, product, args.usesNonFinite() || partial.mayBeNonFinite(args),
        createSlope);
    if (!b.mayBeNonFinite(operand) && saturates(op, partial.operand))
      term = b.createGuard(createSlope(), term);
    sum = sum ? Value(arith::AddFOp::create(b, sum, term)) : term;
  }
  b.setTangent(op->getResult(0), sum);
}

/// A guard stands for the product g p, with 0 where g = 0 whatever p is. The
/// derivative of that is g' p + g p', with 0 where both g and g' are zero.
static LogicalResult applyGuardRule(arith::SelectOp guard, TangentBuilder &b) {
  Value guarded = getGuarded(guard);
  if (!guarded) {
    b.emitError(guard, "cannot differentiate this guard against zero again");
    return failure();
  }
  Value product = b.getTangent(guard.getFalseValue());
  if (!product)
    return success();
  Value condition = guard.getCondition();
  if (Value tangent = b.getTangent(guarded)) {
    if (!isa<VectorType>(condition.getType()) &&
        isa<VectorType>(tangent.getType()))
      tangent = b.createSum(math::AbsFOp::create(b, tangent));
    Value isZero = arith::CmpFOp::create(b, arith::CmpFPredicate::OEQ, tangent,
                                         b.createZero(tangent.getType()));
    condition = arith::AndIOp::create(b, condition, isZero);
  }
  auto again = arith::SelectOp::create(
      b, condition, b.createZero(product.getType()), product);
  // This rule does not know the condition of the new guard: a third derivative
  // is refused.
  again->setAttr(kGuard, b.getUnitAttr());
  b.setTangent(guard, again);
  return success();
}

Value mlir::tai::createUpdatedTangent(TangentBuilder &b, UpdateKind kind,
                                      Value old, Value oldTangent,
                                      Value value) {
  Value tangent = b.getTangent(value);
  if (kind == UpdateKind::Product) {
    Value kept = arith::MulFOp::create(b, oldTangent, value);
    if (b.getFacts().mayBeNonFinite(value))
      kept = b.createGuard(oldTangent, kept);
    if (!tangent)
      return kept;
    Value added =
        b.createProduct(value, arith::MulFOp::create(b, old, tangent),
                        /*partialMayBeNonFinite=*/false, [&] { return old; });
    return arith::AddFOp::create(b, kept, added);
  }
  auto predicate = kind == UpdateKind::Greatest ? arith::CmpFPredicate::OGT
                                                : arith::CmpFPredicate::OLT;
  Value stays = arith::CmpFOp::create(b, predicate, old, value);
  Value comes = b.getTangentOrZero(value);
  if (b.getConventions().splitTies) {
    Value isTie =
        arith::CmpFOp::create(b, arith::CmpFPredicate::OEQ, old, value);
    Value half =
        arith::MulFOp::create(b, b.createConstant(comes.getType(), 0.5),
                              arith::AddFOp::create(b, oldTangent, comes));
    comes = arith::SelectOp::create(b, isTie, half, comes);
  }
  return arith::SelectOp::create(b, stays, oldTangent, comes);
}

namespace {
/// The model of an op that has a rule in the table of ScalarRules.cpp.
template <typename OpTy>
struct ScalarModel
    : DifferentiableOpInterface::ExternalModel<ScalarModel<OpTy>, OpTy> {
  LogicalResult buildAdjoint(Operation *op, AdjointBuilder &adjoint) const {
    applyRule(op, adjoint);
    return success();
  }
  LogicalResult buildTangent(Operation *op, TangentBuilder &tangent) const {
    if (auto select = dyn_cast<arith::SelectOp>(op);
        select && op->hasAttr(kGuard))
      return applyGuardRule(select, tangent);
    applyTangentRule(op, tangent);
    return success();
  }
  bool carriesDerivative(Operation *op, OpOperand &operand) const {
    return llvm::any_of(getRule(op).partials, [&](const Partial &partial) {
      return partial.operand == operand.getOperandNumber();
    });
  }
};

/// math.sincos has two results, sin x and cos x.
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
  LogicalResult buildTangent(Operation *op, TangentBuilder &b) const {
    auto sincos = cast<math::SincosOp>(op);
    Value x = sincos.getOperand(), tangent = b.getTangent(x);
    auto times = [&](Value partial) {
      return b.createProduct(x, arith::MulFOp::create(b, tangent, partial),
                             b.getFacts().mayBeNonFinite(x),
                             [&] { return partial; });
    };
    b.setTangent(sincos.getSin(), times(sincos.getCos()));
    b.setTangent(sincos.getCos(),
                 arith::NegFOp::create(b, times(sincos.getSin())));
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
