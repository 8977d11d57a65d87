//===- DerivativeBuilder.h - Shared by rules of both modes ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The part of a derivative rule that is the same in both modes: access to
// primal values, and small helpers to build formulas. AdjointBuilder is reverse
// mode, TangentBuilder forward mode.
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

/// Marks a kernel as guarded if it contains guards: selects that give zero
/// where the incoming derivative is zero, even if the partial derivative is
/// infinite or NaN.
void noteGuards(FunctionOpInterface function);
/// Reports an error if a kernel with guards has lost the marks on its guards: a
/// guard that is differentiated as a branch gets a wrong zero derivative.
LogicalResult checkGuards(FunctionOpInterface function);

class DerivativeBuilder : public ImplicitLocOpBuilder {
public:
  /// Builds derivatives of `function` under its own conventions at kinks. With
  /// `usesConditions`, facts about values may use the conditions of enclosing
  /// branches.
  explicit DerivativeBuilder(FunctionOpInterface function,
                             bool usesConditions = false);
  virtual ~DerivativeBuilder();

  /// The value, in the derivative function being built, of a primal value.
  virtual Value getPrimal(Value value) = 0;
  /// Facts about primal floats, such as their sign or that they are finite.
  FloatFacts &getFacts() { return facts; }
  /// The subgradients that the program chose at kinks.
  const Conventions &getConventions() const { return conventions; }

  /// Creates a float constant, or a splat for a vector type.
  Value createConstant(Type type, double value);
  Value createZero(Type type) { return createConstant(type, 0.0); }
  /// Extracts one component (row-major) of a vector of any rank.
  Value createExtract(Value vector, int64_t component);
  /// Creates a vector from its components (row-major); null components are
  /// zero.
  Value createVector(VectorType type, ArrayRef<Value> components);
  /// Creates the sum of all components of a vector. In a function written by
  /// another compiler, emits no op of the dialect tai.
  Value createSum(Value vector);
  /// select(condition, value, 0)
  Value createMask(Value condition, Value value);
  /// select(derivative == 0, 0, value): a zero adjoint or tangent contributes
  /// zero, not NaN. The value itself, if the conventions turn guards off.
  Value createGuard(Value derivative, Value value);

  /// False if the conventions of the function turn guards off.
  bool wantsGuards() const { return conventions.guards; }

private:
  FloatFacts facts;
  Conventions conventions;
  bool isKernel;
};

} // namespace mlir::tai

#endif // TAI_AD_DERIVATIVEBUILDER_H
