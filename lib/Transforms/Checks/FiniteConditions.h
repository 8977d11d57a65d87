//===- FiniteConditions.h - When guards have no effect ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A guard of a derivative has no effect where the partial derivative is finite.
// Which values of the program say so: the divisors that are clear of zero, and
// results such as those of exp and log that are finite. They are fewer than the
// contributions, and known before the first of these.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_CHECKS_FINITECONDITIONS_H
#define TAI_LIB_TRANSFORMS_CHECKS_FINITECONDITIONS_H

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "tai/Analysis/FloatFacts.h"
#include "tai/Dialect/Tai/IR/Guards.h"
#include "llvm/ADT/SetVector.h"

namespace mlir::tai {

inline bool isGuard(Operation *op) {
  return isa<arith::SelectOp>(op) &&
         (op->hasAttr(kGuard) || op->hasAttr(kInfiniteGuard));
}

/// Whether the op makes NaN or infinity of what is not finite in its operand,
/// unless it drops that component.
bool passesOn(OpOperand &use);

/// Whether the op makes NaN or infinity of a NaN or an infinity in any
/// component of the operand: none is dropped.
bool keepsNonFinite(OpOperand &use);

int64_t countComponents(ArrayRef<Value> values);

/// A truth value: whether all components of the values are finite. Null for no
/// values.
Value createTestOfFinite(OpBuilder &builder, Location loc,
                         ArrayRef<Value> values);

/// What must hold of values for guards to have no effect.
class FiniteConditions {
public:
  /// Adds the conditions of a guard in the block, or in a region of its ops.
  /// False if there are none that are known.
  bool require(arith::SelectOp guard, Block &block);

  /// Drops what other conditions imply, and tests results in the place of
  /// several operands, where they are available.
  void simplify(function_ref<bool(Value)> isAvailable);

  /// Every component of these is finite.
  ArrayRef<Value> getFinite() const { return finite.getArrayRef(); }
  /// Every component of these is farther from zero than what can be divided by.
  ArrayRef<Value> getClear() const { return clear.getArrayRef(); }
  /// The number of components that are tested.
  int64_t count() const {
    return countComponents(getFinite()) + countComponents(getClear());
  }

  /// A truth value: whether they hold of those of the values that `isIncluded`.
  /// Null where there are none.
  Value createTest(OpBuilder &builder, Location loc,
                   function_ref<bool(Value)> isIncluded);

private:
  bool requirePartial(arith::SelectOp guard);
  bool requireSeeds(Value value, Block &block);
  bool requireFinite(Value value, Operation *at);
  bool requireClear(Value value, Operation *at, bool isPositive = false);
  bool requireQuotient(Value lhs, Value rhs, Operation *at);
  bool isRequired(Value value);
  void replaceClear(function_ref<bool(Value)> isAvailable);
  bool replaceBySum(function_ref<bool(Value)> isAvailable);
  bool isTold(Value value);
  bool areComponentsTold(Value value);

  FloatFacts facts = FloatFacts(/*usesConditions=*/true);
  llvm::SetVector<Value> finite, clear;
  /// Those of the clear ones that are not below zero where others are finite,
  /// and those that are not only to differ from zero.
  DenseSet<Value> positive, strict;
  DenseSet<Value> required, cleared, followed;
  DenseMap<Value, bool> told;
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_CHECKS_FINITECONDITIONS_H
