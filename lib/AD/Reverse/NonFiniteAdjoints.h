//===- NonFiniteAdjoints.h - Infinite and undefined adjoints ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Some derivatives are infinite where the program is finite, as that of sqrt at
// zero, and some do not exist. A rule marks the values whose adjoints may be
// so. Rules that start from such an adjoint get no NaN from the product of an
// infinite adjoint and a partial derivative of zero.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_REVERSE_NONFINITEADJOINTS_H
#define TAI_LIB_AD_REVERSE_NONFINITEADJOINTS_H

#include "tai/AD/AdjointBuilder.h"

namespace mlir::tai {

class NonFiniteAdjoints {
public:
  explicit NonFiniteAdjoints(AdjointBuilder &builder) : b(builder) {}

  /// Finds what loops and branches hand on. An iteration may begin with what a
  /// later one has made infinite, so that this is known before the first rule.
  void findHandedOn(FunctionOpInterface function);

  void markInfinite(Value value) { mayBeInfinite.insert(value); }
  void markUndefined(Value value) { mayBeUndefined.insert(value); }

  /// Before and after the rule of `op`.
  void beginRule(Operation *op);
  void endRule();
  /// True if an adjoint that the rule starts from may be NaN.
  bool isSeedUndefined() const { return seedIsUndefined; }

  /// What the rule contributes to the adjoint of `value`.
  Value guard(Value value, Value contribution);

private:
  void findSeeds(Operation *op);
  Value createInfinityTest();
  Value createUnitContribution(Value contribution);
  Value createTagged(Value drops, Value contribution);

  AdjointBuilder &b;
  DenseSet<Value> mayBeInfinite, mayBeUndefined;
  /// The op whose rule is applied, the adjoints that it starts from, and those
  /// among them that may be infinite.
  Operation *current = nullptr;
  llvm::SmallSetVector<Value, 2> seeds;
  SmallVector<Value, 2> infiniteSeeds;
  /// Whether one of them is, once that has been asked.
  Value seedIsInfinite;
  /// Whether one of them may be NaN.
  bool seedIsUndefined = false;
};

} // namespace mlir::tai

#endif // TAI_LIB_AD_REVERSE_NONFINITEADJOINTS_H
