//===- DerivativeBuilder.h - What rules of both modes call ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The part of a rule that does not depend on the direction in which derivatives
// are carried: the primal values that a partial derivative needs, and small
// helpers to build formulas. AdjointBuilder carries derivatives backwards,
// TangentBuilder forwards.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_DERIVATIVEBUILDER_H
#define TAI_AD_DERIVATIVEBUILDER_H

#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/AD/Conventions.h"
#include "tai/Analysis/FloatFacts.h"
#include "tai/Dialect/Tai/IR/Guards.h"

namespace mlir::tai {

/// Notes on a kernel that it has guards.
void noteGuards(FunctionOpInterface function);
/// Reports an error if a kernel that has guards lost their marks: taken for
/// branches, their derivatives would be zero where they are not.
LogicalResult checkGuards(FunctionOpInterface function);

class DerivativeBuilder : public ImplicitLocOpBuilder {
public:
  /// For derivatives of `function`, which says what its conventions are.
  /// With `usesConditions`, what branches say of values counts among the facts.
  explicit DerivativeBuilder(FunctionOpInterface function,
                             bool usesConditions = false);
  virtual ~DerivativeBuilder();

  /// What stands for a value of the primal program in the one that is built.
  virtual Value getPrimal(Value value) = 0;
  /// What is known of primal values.
  FloatFacts &getFacts() { return facts; }
  /// What the program chose at kinks.
  const Conventions &getConventions() const { return conventions; }

  /// A float or splat constant of the given type.
  Value createConstant(Type type, double value);
  Value createZero(Type type) { return createConstant(type, 0.0); }
  /// A component (row-major) of a vector of any rank.
  Value createExtract(Value vector, int64_t component);
  /// A vector from components, null for zero.
  Value createVector(VectorType type, ArrayRef<Value> components);
  /// select(condition, value, 0)
  Value createMask(Value condition, Value value);
  /// select(derivative == 0, 0, value): a zero adjoint or tangent contributes
  /// zero. Just the value, if the program wants no guards.
  Value createGuard(Value derivative, Value value);

  /// False if the program wants no tests for zero derivatives.
  bool wantsGuards() const { return conventions.guards; }

private:
  FloatFacts facts;
  Conventions conventions;
};

} // namespace mlir::tai

#endif // TAI_AD_DERIVATIVEBUILDER_H
