//===- ScalarRules.h - The table of derivatives -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The form of the rows of ScalarRules.cpp, and a small notation for formulas on
// SSA values.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_RULES_SCALARRULES_H
#define TAI_LIB_AD_RULES_SCALARRULES_H

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "tai/AD/Conventions.h"
#include "tai/AD/DerivativeBuilder.h"

namespace mlir::tai {

/// A float value, or a vector of floats used component by component.
struct Num {
  DerivativeBuilder *builder;
  Value value;
};

/// A truth value in a formula, or a vector of truth values.
struct Truth {
  DerivativeBuilder *builder;
  Value value;
};

template <typename OpTy> Num make(Num a) {
  return {a.builder, OpTy::create(*a.builder, a.value)};
}
template <typename OpTy> Num make(Num a, Num b) {
  return {a.builder, OpTy::create(*a.builder, a.value, b.value)};
}
inline Num constant(Num like, double value) {
  return {like.builder,
          like.builder->createConstant(like.value.getType(), value)};
}
inline Truth compare(arith::CmpFPredicate predicate, Num a, Num b) {
  return {a.builder,
          arith::CmpFOp::create(*a.builder, predicate, a.value, b.value)};
}

inline Num operator+(Num a, Num b) { return make<arith::AddFOp>(a, b); }
inline Num operator-(Num a, Num b) { return make<arith::SubFOp>(a, b); }
inline Num operator*(Num a, Num b) { return make<arith::MulFOp>(a, b); }
inline Num operator/(Num a, Num b) { return make<arith::DivFOp>(a, b); }
inline Num operator-(Num a) { return make<arith::NegFOp>(a); }
inline Num operator+(double a, Num b) { return constant(b, a) + b; }
inline Num operator-(double a, Num b) { return constant(b, a) - b; }
inline Num operator-(Num a, double b) { return a - constant(a, b); }
inline Num operator*(double a, Num b) { return constant(b, a) * b; }

inline Truth operator>(Num a, Num b) {
  return compare(arith::CmpFPredicate::OGT, a, b);
}
inline Truth operator<(Num a, Num b) {
  return compare(arith::CmpFPredicate::OLT, a, b);
}
inline Truth operator==(Num a, Num b) {
  return compare(arith::CmpFPredicate::OEQ, a, b);
}
inline Truth operator==(Num a, double b) {
  return compare(arith::CmpFPredicate::OEQ, a, constant(a, b));
}
inline Truth operator>(Num a, double b) { return a > constant(a, b); }
inline Truth operator<(Num a, double b) { return a < constant(a, b); }
inline Truth isNaN(Num a) { return compare(arith::CmpFPredicate::UNE, a, a); }
inline Truth operator||(Truth a, Truth b) {
  return {a.builder, arith::OrIOp::create(*a.builder, a.value, b.value)};
}
inline Num select(Truth condition, Num a, Num b) {
  return {a.builder, arith::SelectOp::create(*a.builder, condition.value,
                                             a.value, b.value)};
}
/// Emits `a` where the condition holds, and zero elsewhere.
inline Num where(Truth condition, Num a) {
  return select(condition, a, constant(a, 0));
}
inline Num unless(Truth condition, Num a) {
  return select(condition, constant(a, 0), a);
}

/// The values that the formula of a derivative rule may use. A primal value is
/// recomputed in the adjoint only if the formula uses it.
class RuleArgs {
public:
  /// Tells whether a formula is used for an adjoint or a tangent. Backward:
  /// `seed` is the adjoint of the result, and the formula yields the
  /// contribution to the adjoint of an operand. A formula is linear in the seed
  /// and component-wise, so that it is its own transpose. Forward: `seed` is
  /// the tangent of the operand, and the formula yields the contribution to the
  /// tangent of the result.
  enum class Mode { Backward, Forward };

  RuleArgs(DerivativeBuilder &builder, Operation *op, Value seed,
           Mode mode = Mode::Backward)
      : builder(builder), op(op), seed(seed), mode(mode) {}

  /// The seed of the formula, by which it is multiplied: the adjoint of the
  /// result, or in forward mode the tangent of the operand.
  Num g() { return {&builder, seed}; }
  /// The operands.
  Num x() { return use(getOperand(0)); }
  Num y() { return use(getOperand(1)); }
  Num z() { return use(getOperand(2)); }
  /// The result.
  Num r() { return use(op->getResult(0)); }
  /// Returns operand number `i` of the op, which is a condition or an integer.
  Truth truth(unsigned i) {
    return {&builder, builder.getPrimal(op->getOperand(i))};
  }
  /// Makes the rule use `values` in place of the first operands of the op; null
  /// stands for the constant 1. Used to differentiate an equivalent op (see
  /// SharedFactors.h).
  void setOperands(ArrayRef<Value> values) {
    replaced.assign(values.begin(), values.end());
  }
  /// Returns operand number `i` of the op, or the value set by setOperands in
  /// its place; null stands for the constant 1.
  Value getOperand(unsigned i) {
    return i < replaced.size() ? replaced[i] : op->getOperand(i);
  }
  /// Converts `a` to the float type of operand i (Backward) or of the result
  /// (Forward).
  Num cast(Num a, unsigned i);

  Operation *getOperation() { return op; }
  /// The subgradients that the program chose at kinks, such as |x| at 0.
  Conventions getConventions() { return Conventions::of(op); }
  FloatFacts &facts() { return builder.getFacts(); }
  /// True if some primal value that the formula has used so far may be infinite
  /// or NaN.
  bool usesNonFinite() const { return usedNonFinite; }

private:
  Num use(Value value) {
    if (!value)
      return {&builder, builder.createConstant(op->getResult(0).getType(), 1)};
    usedNonFinite |= facts().mayBeNonFinite(value);
    return {&builder, builder.getPrimal(value)};
  }

  DerivativeBuilder &builder;
  Operation *op;
  Value seed;
  Mode mode;
  SmallVector<Value, 2> replaced;
  bool usedNonFinite = false;
};

/// The partial derivative of an op with respect to one operand.
struct Partial {
  /// Position of the operand.
  unsigned operand;
  /// The contribution to the adjoint of the operand as text, for documentation:
  /// g is the adjoint of the result r, and x, y, z are the operands.
  const char *formula;
  /// False if the partial is finite wherever the operands are; then no guard
  /// for a zero adjoint is needed.
  bool (*mayBeNonFinite)(RuleArgs &);
  /// Builds the contribution.
  Num (*build)(RuleArgs &);
};

/// The derivative rule of one op: its partial derivatives. An operand without a
/// partial has derivative zero.
struct ScalarRule {
  const char *op;
  SmallVector<Partial, 3> partials;
  /// The values of the derivative at kinks and singular points as text, for
  /// documentation.
  const char *kinks = "";
};

/// All rules.
ArrayRef<ScalarRule> getScalarRules();

} // namespace mlir::tai

#endif // TAI_LIB_AD_RULES_SCALARRULES_H
