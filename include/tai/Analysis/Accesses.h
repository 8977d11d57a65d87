//===- Accesses.h - Elements that a kernel touches --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Whether two accesses touch the same element, and whether distinct iterations
// of a parallel loop touch distinct elements.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_ACCESSES_H
#define TAI_ANALYSIS_ACCESSES_H

#include "mlir/IR/AffineMap.h"
#include "mlir/IR/Value.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Analysis/Index/IndexQueries.h"
#include "tai/Interfaces/Differentiable.h"

namespace mlir::tai {
class FieldOp;

/// True if the two lists of indices are equal whenever both are evaluated in
/// the same iteration of the loops around them.
bool areProvablyEqual(ValueRange lhs, ValueRange rhs);

/// True if the index lists `lhs` and `rhs`, evaluated in the same iteration of
/// the loops around them, certainly differ in at least one position.
bool areProvablyDistinct(ValueRange lhs, ValueRange rhs);

/// True if no two iterations of a parallel loop reach the same element by any
/// of `accesses`, which are all accesses to one storage in one outermost
/// parallel loop.
bool isExclusive(ArrayRef<Operation *> accesses);

/// The induction variables of an op that runs its body in parallel, or none.
ValueRange getParallelInductionVars(Operation *op);
/// The innermost parallel loop around `op`, or null.
Operation *getEnclosingParallelLoop(Operation *op);
/// The outermost parallel loop around `op`, or null.
Operation *getOutermostParallelLoop(Operation *op);
/// The induction variables of all loops between `op` and the function around
/// it, from the outermost to the innermost.
SmallVector<Value> getEnclosingInductionVars(Operation *op);
/// The op whose region has `iv` as an argument.
Operation *getLoopOf(Value iv);

/// Returns the indices of an access as a map from the induction variables of
/// the loops around `access` (dimensions) and the integer arguments of the
/// function (symbols), or null if an index is not affine in these variables and
/// arguments.
AffineMap getAffineMap(Operation *access, ValueRange indices);

/// A key for the storage that an access reaches; equal for all `tai.field` ops
/// of one place.
const void *getStorageKey(Operation *op);
const void *getFieldStorageKey(FieldOp field);

/// Marks each `tai.atomic` add or sub as exclusive where no other iteration of
/// the parallel loop around it can reach its element, and removes the mark
/// elsewhere.
void markExclusiveAtomics(FunctionOpInterface function);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_ACCESSES_H
