//===- FloatFacts.cpp - What is known about a float -----------------------===//
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
#include "tai/AD/Differentiable.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/TypeSwitch.h"

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
  if (auto splat = dyn_cast<SplatElementsAttr>(attr);
      splat && isa<FloatType>(splat.getElementType()))
    return predicate(splat.getSplatValue<APFloat>());
  if (auto dense = dyn_cast<DenseFPElementsAttr>(attr))
    return llvm::all_of(dense.getValues<APFloat>(), predicate);
  return false;
}

static bool isConstantPositive(Value value) {
  return matchConstant(value, [](const APFloat &x) {
    return x.isFinite() && !x.isZero() && !x.isNegative();
  });
}

bool FloatFacts::isPositive(Value value, unsigned depth) {
  if (isConstantPositive(value))
    return true;
  Operation *op = value.getDefiningOp();
  if (!op || depth-- == 0)
    return false;
  auto both = [&](Value a, Value b) {
    return isPositive(a, depth) && isPositive(b, depth);
  };
  auto either = [&](Value a, Value b) {
    return isPositive(a, depth) || isPositive(b, depth);
  };
  return llvm::TypeSwitch<Operation *, bool>(op)
      .Case<arith::AddFOp>([&](auto op) {
        Value a = op.getLhs(), b = op.getRhs();
        return (isPositive(a, depth) && isNonNegative(b, depth)) ||
               (isNonNegative(a, depth) && isPositive(b, depth));
      })
      .Case<arith::MaximumFOp, arith::MaxNumFOp>(
          [&](auto op) { return either(op.getLhs(), op.getRhs()); })
      .Case<arith::MinimumFOp, arith::MinNumFOp>(
          [&](auto op) { return both(op.getLhs(), op.getRhs()); })
      .Case<arith::SelectOp>(
          [&](auto op) { return both(op.getTrueValue(), op.getFalseValue()); })
      .Case<math::SqrtOp, math::AbsFOp>(
          [&](auto op) { return isPositive(op.getOperand(), depth); })
      .Case<math::ClampFOp>(
          [&](auto op) { return both(op.getMin(), op.getMax()); })
      .Case<math::CoshOp>([](auto) { return true; })
      .Case<arith::ExtFOp>(
          [&](auto op) { return isPositive(op.getIn(), depth); })
      .Case<vector::BroadcastOp>(
          [&](auto op) { return isPositive(op.getSource(), depth); })
      .Default([](Operation *) { return false; });
}

bool FloatFacts::isNonNegative(Value value, unsigned depth) {
  if (matchConstant(value, [](const APFloat &x) {
        return !x.isNaN() && (!x.isNegative() || x.isZero());
      }))
    return true;
  Operation *op = value.getDefiningOp();
  if (!op || depth-- == 0)
    return false;
  auto both = [&](Value a, Value b) {
    return isNonNegative(a, depth) && isNonNegative(b, depth);
  };
  auto either = [&](Value a, Value b) {
    return isNonNegative(a, depth) || isNonNegative(b, depth);
  };
  return llvm::TypeSwitch<Operation *, bool>(op)
      .Case<arith::MulFOp>([&](auto op) {
        return op.getLhs() == op.getRhs() || both(op.getLhs(), op.getRhs());
      })
      .Case<arith::AddFOp, arith::DivFOp, arith::MinimumFOp, arith::MinNumFOp>(
          [&](auto op) { return both(op.getLhs(), op.getRhs()); })
      .Case<arith::MaximumFOp, arith::MaxNumFOp>(
          [&](auto op) { return either(op.getLhs(), op.getRhs()); })
      .Case<arith::SelectOp>(
          [&](auto op) { return both(op.getTrueValue(), op.getFalseValue()); })
      .Case<math::ClampFOp>(
          [&](auto op) { return both(op.getMin(), op.getMax()); })
      .Case<math::FmaOp>([&](auto op) {
        return op.getA() == op.getB() && isNonNegative(op.getC(), depth);
      })
      .Case<math::AbsFOp, math::SqrtOp, math::ExpOp, math::Exp2Op, math::CoshOp,
            math::AcosOp, math::AcoshOp, math::ErfcOp, NormOp>(
          [](auto) { return true; })
      .Case<DotOp>([](auto op) { return op.getLhs() == op.getRhs(); })
      .Case<SumOp>(
          [&](auto op) { return isNonNegative(op.getVector(), depth); })
      .Case<math::FPowIOp>([&](auto op) {
        APInt power;
        return matchPattern(op.getRhs(), m_ConstantInt(&power)) && !power[0];
      })
      .Case<math::PowFOp>(
          [&](auto op) { return isNonNegative(op.getLhs(), depth); })
      .Case<arith::ExtFOp, arith::TruncFOp>(
          [&](auto op) { return isNonNegative(op.getIn(), depth); })
      .Case<arith::UIToFPOp>([](auto) { return true; })
      .Case<vector::BroadcastOp, vector::ExtractOp>(
          [&](auto op) { return isNonNegative(op.getSource(), depth); })
      .Default([](Operation *) { return false; });
}

bool FloatFacts::isNonZero(Value value) {
  if (matchConstant(
          value, [](const APFloat &x) { return x.isFinite() && !x.isZero(); }))
    return true;
  if (auto neg = value.getDefiningOp<arith::NegFOp>())
    return isNonZero(neg.getOperand());
  return isPositive(value);
}

bool FloatFacts::isNonPositive(Value value) {
  if (matchConstant(value, [](const APFloat &x) {
        return !x.isNaN() && (x.isNegative() || x.isZero());
      }))
    return true;
  Operation *op = value.getDefiningOp();
  if (!op)
    return false;
  return llvm::TypeSwitch<Operation *, bool>(op)
      .Case<arith::NegFOp>(
          [&](auto op) { return isNonNegative(op.getOperand()); })
      .Case<arith::MulFOp>([&](auto op) {
        auto isMixed = [&](Value a, Value b) {
          return isNonNegative(a) && isNonPositive(b);
        };
        return isMixed(op.getLhs(), op.getRhs()) ||
               isMixed(op.getRhs(), op.getLhs());
      })
      .Case<arith::DivFOp>([&](auto op) {
        return isNonPositive(op.getLhs()) && isPositive(op.getRhs());
      })
      .Case<arith::MinimumFOp, arith::MinNumFOp>([&](auto op) {
        return isNonPositive(op.getLhs()) || isNonPositive(op.getRhs());
      })
      .Default([](Operation *) { return false; });
}

bool FloatFacts::isInUnitInterval(Value value) {
  auto isInside = [](Value bound) {
    return matchConstant(bound, [](const APFloat &x) {
      APFloat magnitude = abs(x);
      APFloat one(x.getSemantics(), 1);
      return magnitude.isFinite() &&
             magnitude.compare(one) != APFloat::cmpGreaterThan;
    });
  };
  if (isInside(value))
    return true;
  Operation *op = value.getDefiningOp();
  if (!op)
    return false;
  return llvm::TypeSwitch<Operation *, bool>(op)
      .Case<math::SinOp, math::CosOp, math::TanhOp, math::ErfOp>(
          [](auto) { return true; })
      .Case<math::ClampFOp>([&](auto op) {
        return isInside(op.getMin()) && isInside(op.getMax());
      })
      .Default([](Operation *) { return false; });
}

/// Of ops whose value can be infinite or NaN though all operands are finite.
static bool makesNonFinite(Operation *op, FloatFacts &facts) {
  return llvm::TypeSwitch<Operation *, bool>(op)
      .Case<arith::DivFOp, arith::RemFOp>(
          [&](auto op) { return !facts.isNonZero(op.getRhs()); })
      .Case<math::SqrtOp>(
          [&](auto op) { return !facts.isNonNegative(op.getOperand()); })
      .Case<math::RsqrtOp, math::LogOp, math::Log2Op, math::Log10Op>(
          [&](auto op) { return !facts.isPositive(op.getOperand()); })
      .Case<math::Log1pOp>(
          [&](auto op) { return !facts.isNonNegative(op.getOperand()); })
      .Case<math::ExpOp, math::Exp2Op, math::ExpM1Op>(
          [&](auto op) { return !facts.isNonPositive(op.getOperand()); })
      .Case<math::AcosOp, math::AsinOp>(
          [&](auto op) { return !facts.isInUnitInterval(op.getOperand()); })
      .Case<math::PowFOp, math::FPowIOp, math::AcoshOp, math::AtanhOp,
            math::CoshOp, math::SinhOp, InverseOp, SolveOp>(
          [](auto) { return true; })
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
    // While the answer was open it counted as no, since a loop asks for itself.
    // What was concluded from that does not hold.
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
    return true; // what arrives there is not looked into
  if (matchPattern(op, m_Constant()))
    return !matchConstant(value, [](const APFloat &x) { return x.isFinite(); });
  // The bounds of a clamp hold for an infinite operand too; NaN passes, but
  // comes from an operand that is itself not finite.
  return makesNonFinite(op, *this) ||
         llvm::any_of(op->getOperands(),
                      [&](Value operand) { return mayBeNonFinite(operand); });
}

bool mlir::tai::mayHaveNonFinitePartial(Operation *op, FloatFacts &facts) {
  if (makesNonFinite(op, facts))
    return true;
  return llvm::TypeSwitch<Operation *, bool>(op)
      .Case<math::SqrtOp, math::CbrtOp>(
          [&](auto op) { return !facts.isPositive(op.getOperand()); })
      .Case<math::TanOp>([](auto) { return true; })
      .Case<math::AcosOp, math::AsinOp>([](auto) { return true; })
      .Case<math::Atan2Op>([](auto) { return false; })
      .Default([](Operation *) { return false; });
}
