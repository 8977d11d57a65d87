//===- NonFiniteAdjoints.h - Infinite and undefined adjoints ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Some derivatives are infinite where the program is finite, as that of sqrt at
// zero, and some do not exist. A rule marks the values whose adjoints may be
// infinite or NaN. In rules with such an incoming adjoint, the product of an
// infinite adjoint and a zero partial derivative is zero, not NaN.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_REVERSE_NONFINITEADJOINTS_H
#define TAI_LIB_AD_REVERSE_NONFINITEADJOINTS_H

#include "tai/AD/Reverse/AdjointBuilder.h"

namespace mlir::tai {

class NonFiniteAdjoints {
public:
  explicit NonFiniteAdjoints(AdjointBuilder &builder) : b(builder) {}

  /// Propagates the marks through values that loops and branches forward. In
  /// reverse, an iteration's adjoint may be infinite because of a later one, so
  /// this must run before the first rule.
  void propagateMarks(FunctionOpInterface function);

  void markInfinite(Value value) { mayBeInfinite.insert(value); }
  void markUndefined(Value value) { mayBeUndefined.insert(value); }

  /// Must be called before and after the derivative rule of `op` is applied.
  void beginRule(Operation *op);
  void endRule();
  /// True if an incoming adjoint of the current derivative rule may be NaN.
  bool isSeedUndefined() const { return seedIsUndefined; }

  /// Emits the contribution of the current derivative rule to the adjoint of
  /// `value`, with a guard if one is needed.
  Value guard(Value value, Value contribution);

private:
  void findSeeds(Operation *op);
  Value createInfinityTest();
  Value createUnitContribution(Value contribution);
  Value createTagged(Value drops, Value contribution);

  AdjointBuilder &b;
  DenseSet<Value> mayBeInfinite, mayBeUndefined;
  /// The op whose derivative rule is being applied, its incoming adjoints, and
  /// the incoming adjoints that may be infinite.
  Operation *current = nullptr;
  llvm::SmallSetVector<Value, 2> seeds;
  SmallVector<Value, 2> infiniteSeeds;
  /// A value of type i1: whether an incoming adjoint is infinite. Null until
  /// needed.
  Value seedIsInfinite;
  /// True if an incoming adjoint of the current derivative rule may be NaN.
  bool seedIsUndefined = false;
};

} // namespace mlir::tai

#endif // TAI_LIB_AD_REVERSE_NONFINITEADJOINTS_H
