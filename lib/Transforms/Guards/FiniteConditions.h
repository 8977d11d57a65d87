//===- FiniteConditions.h - When guards are not needed ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A guard of a derivative has no effect where the partial derivative is finite.
// Sufficient conditions are that some primal values are finite or far from
// zero: divisors, and results such as those of exp and log. These are fewer
// than the guarded products, and known before the first of them.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_GUARDS_FINITECONDITIONS_H
#define TAI_LIB_TRANSFORMS_GUARDS_FINITECONDITIONS_H

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "tai/Analysis/FloatFacts.h"
#include "tai/Dialect/Tai/IR/Guards.h"
#include "llvm/ADT/SetVector.h"

namespace mlir::tai {

inline bool isGuard(Operation *op) {
  return isa<arith::SelectOp>(op) &&
         (op->hasAttr(kGuard) || op->hasAttr(kInfiniteGuard));
}

/// True if the op propagates a non-finite component of the operand to its
/// result, unless the op drops that component.
bool passesOn(OpOperand &use);

/// True if the op propagates every non-finite component of the operand to its
/// result and drops none.
bool keepsNonFinite(OpOperand &use);

int64_t countComponents(ArrayRef<Value> values);

/// Emits an i1 that is true if all components of the values are finite. Null
/// for an empty list.
Value createTestOfFinite(OpBuilder &builder, Location loc,
                         ArrayRef<Value> values);

/// The conditions on values under which guards have no effect.
class FiniteConditions {
public:
  /// Sets the ops whose results may be non-finite, because the conditions of
  /// their guards are not required here.
  void setApart(DenseSet<Operation *> ops) { apart = std::move(ops); }

  /// Adds the conditions of a guard in the block, or in a region of its ops.
  /// False if no sufficient conditions of the guard are known.
  bool require(arith::SelectOp guard, Block &block);

  /// Drops conditions that follow from others, and replaces tests of several
  /// operands by a test of their result, if that is available.
  void simplify(function_ref<bool(Value)> isAvailable);

  /// The values of which every component must be finite.
  ArrayRef<Value> getFinite() const { return finite.getArrayRef(); }
  /// The values of which every component must be far enough from zero to divide
  /// by it.
  ArrayRef<Value> getClear() const { return clear.getArrayRef(); }
  /// Finds the values that are not zero where the conditions hold.
  DenseSet<Value> findNonZero() const;
  /// The number of components of values that the conditions test.
  int64_t count() const {
    return countComponents(getFinite()) + countComponents(getClear());
  }

  /// Emits an i1 that is true if the conditions on values with `isIncluded`
  /// hold. Null if there are no such conditions.
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
  /// Subsets of the values that must be far from zero. positive: values that
  /// are non-negative if the other conditions hold. strict: values for which it
  /// is not enough to be non-zero.
  DenseSet<Value> positive, strict;
  DenseSet<Value> required, cleared, followed;
  DenseSet<Operation *> apart;
  /// The block of the guards: values defined before it are not analyzed
  /// further.
  Block *scope = nullptr;
  DenseMap<Value, bool> told;
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_GUARDS_FINITECONDITIONS_H
