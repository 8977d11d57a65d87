//===- Accesses.h - Elements that a kernel touches --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Index arithmetic as linear forms, and the queries based on them: whether two
// accesses touch the same element, and whether distinct iterations of a
// parallel loop touch distinct elements.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_ACCESSES_H
#define TAI_ANALYSIS_ACCESSES_H

#include "mlir/IR/AffineMap.h"
#include "mlir/IR/Value.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Interfaces/Differentiable.h"

namespace mlir::tai {
class FieldOp;

/// A sum of values times constants, plus a constant. Terms are sorted by value
/// and have non-zero coefficients. A value that is not itself a sum is a term,
/// as is the result of 8-bit or 16-bit arithmetic, which may wrap around.
struct LinearIndex {
  SmallVector<std::pair<Value, int64_t>, 2> terms;
  int64_t constant = 0;
  /// A product was taken in a type narrower than 64 bits: equal forms are
  /// equal values, but distinct forms may wrap to the same value.
  bool mayWrap = false;

  bool operator==(const LinearIndex &other) const {
    return constant == other.constant && terms == other.terms;
  }
  int64_t getCoefficient(Value value) const;
};

/// The linear form of an integer or index value.
LinearIndex getLinearIndex(Value value);
SmallVector<LinearIndex> getLinearIndices(ValueRange values);

/// True if the two lists of indices are equal whenever both are evaluated in
/// the same iteration of the loops around them.
bool areProvablyEqual(ValueRange lhs, ValueRange rhs);

/// True if the values certainly differ, in the same iteration, in at least one
/// position.
bool areProvablyDistinct(ValueRange lhs, ValueRange rhs);

/// True if different values of `ivs` give different values of at least one of
/// `indices`, all else in them being equal.
bool isInjectiveOver(ArrayRef<LinearIndex> indices, ValueRange ivs);

/// True if no two iterations of the parallel loop reach the same element by any
/// of the writes, given by their indices.
bool isExclusive(Operation *loop, ArrayRef<SmallVector<LinearIndex>> writes);

/// The induction variables of an op that runs its body in parallel, or none.
ValueRange getParallelInductionVars(Operation *op);
/// The innermost parallel loop around `op`, or null.
Operation *getEnclosingParallelLoop(Operation *op);
/// The induction variables of all loops between `op` and the function around
/// it, from the outermost to the innermost.
SmallVector<Value> getEnclosingInductionVars(Operation *op);
/// The op whose region has `iv` as an argument.
Operation *getLoopOf(Value iv);

/// The indices as a map from the induction variables of the loops around
/// `access` (dimensions) and the integer arguments of the function (symbols),
/// or null where they are not affine in these.
AffineMap getAffineMap(Operation *access, ValueRange indices);

/// A key for the storage that an access reaches; equal for all `tai.field` ops
/// of one place.
const void *getStorageKey(Operation *op);
/// The key of a field.
const void *getFieldStorageKey(FieldOp field);

/// Marks each `tai.atomic` add or sub as exclusive where no other iteration of
/// the parallel loop around it can reach its element, and removes the mark
/// where that does not hold.
void markExclusiveAtomics(FunctionOpInterface function);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_ACCESSES_H
