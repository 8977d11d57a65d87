//===- IndexQueries.h - Questions about index expressions -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_INDEX_INDEXQUERIES_H
#define TAI_ANALYSIS_INDEX_INDEXQUERIES_H

#include "tai/Analysis/Index/IndexBuilder.h"

namespace mlir::tai {

/// No loop has more iterations along a dimension: indices of 32 bits would run
/// through all numbers, and leave each field.
constexpr int64_t kMostIterations = (int64_t(1) << 32) - 1;

/// A sum of unknowns times factors, and a constant, of which it is asked
/// whether its low bits can be zero.
class IndexDifference {
public:
  void addConstant(__int128 value);
  void addUnknown(int64_t factor, IndexRange range);

  bool canBeZero(unsigned width) const;

private:
  __int128 constant = 0;
  /// The greatest common divisor of all factors; 0 if there are none.
  uint64_t divisor = 0;
  unsigned unknowns = 0;
  bool isUnbounded = false;
  IndexRange range{0, 0};
};

/// True if both certainly differ, in the same iteration of the loops around
/// them.
bool areDistinct(const IndexExpr &lhs, const IndexExpr &rhs);

/// Pairs of expressions that are equal, the first in one iteration of a loop
/// and the second in another one, and the equations that follow from them:
/// digits determine their number. Values from outside of the loop are the same
/// in both iterations, as are those of `same`.
class IterationEquations {
public:
  IterationEquations(IndexBuilder &builder, Operation *loop,
                     ArrayRef<Value> same = {})
      : builder(builder), loop(loop), same(same) {}

  void add(const IndexExpr &first, const IndexExpr &second);
  void add(ValueRange first, ValueRange second);
  /// Adds all that follows. True if the values are the same in both iterations.
  bool solve(ValueRange values);
  ArrayRef<std::pair<IndexExpr, IndexExpr>> get() const { return equations; }

private:
  bool isSame(const IndexAtom &first, const IndexAtom &second) const;
  bool isSame(IndexExpr first, IndexExpr second) const;
  void cancel(IndexExpr &first, IndexExpr &second) const;
  void solveOne(IndexExpr first, IndexExpr second);
  void joinDigits();
  void splitDigits(IndexExpr first, IndexExpr second);

  IndexBuilder &builder;
  Operation *loop;
  SmallVector<Value> same;
  SmallVector<std::pair<IndexExpr, IndexExpr>, 4> equations;
  SmallVector<std::pair<IndexAtom, IndexAtom>> solutions;
};

/// True if different values of `ivs`, induction variables of one loop, give
/// different values of at least one of `indices`. Its other induction variables
/// and all values from outside of the loop count as fixed.
bool isInjectiveOver(IndexBuilder &builder, ArrayRef<IndexExpr> indices,
                     ValueRange ivs);
/// The same, by a builder of its own.
bool isInjectiveOver(ArrayRef<IndexExpr> indices, ValueRange ivs);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INDEX_INDEXQUERIES_H
