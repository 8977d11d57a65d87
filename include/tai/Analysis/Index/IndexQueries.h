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

/// The most iterations that a loop has along a dimension: with more, an index
/// of 32 bits would take all values, and no field has so many elements.
constexpr int64_t kMostIterations = (int64_t(1) << 32) - 1;

/// A constant plus unknowns times factors; canBeZero asks whether the low bits
/// of the sum can be zero.
class IndexDifference {
public:
  void addConstant(__int128 value);
  void addUnknown(int64_t factor, IndexRange range);

  bool canBeZero(unsigned width) const;

private:
  __int128 constant = 0;
  /// The greatest common divisor of the factors of the unknowns; 0 without
  /// unknowns.
  uint64_t divisor = 0;
  unsigned unknowns = 0;
  bool isUnbounded = false;
  IndexRange range{0, 0};
};

/// True if the index expressions `lhs` and `rhs` certainly have different
/// values in the same iteration of the loops around them.
bool areDistinct(const IndexExpr &lhs, const IndexExpr &rhs);

/// True if `lhs` in one iteration of `loop` and `rhs` in the same or another
/// one certainly have different values, as 2 * i and 2 * i + 1 have.
bool areDistinctOver(const IndexExpr &lhs, const IndexExpr &rhs,
                     Operation *loop);

/// Equations between two iterations of a loop, the first side in one iteration
/// and the second side in the other, and the equations that follow: a number
/// and its digits determine each other. Values from outside of the loop, and
/// the values of `same`, are equal in both iterations.
class IterationEquations {
public:
  IterationEquations(IndexBuilder &builder, Operation *loop,
                     ArrayRef<Value> same = {})
      : builder(builder), loop(loop), same(same) {}

  void add(const IndexExpr &first, const IndexExpr &second);
  void add(ValueRange first, ValueRange second);
  /// Adds all equations that follow from the present ones. True if each of
  /// `values` is then known to be the same in both iterations.
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
/// different values of at least one of `indices`. The loop's other induction
/// variables and all values from outside of the loop count as fixed.
bool isInjectiveOver(IndexBuilder &builder, ArrayRef<IndexExpr> indices,
                     ValueRange ivs);
/// Like the overload above, with a temporary IndexBuilder.
bool isInjectiveOver(ArrayRef<IndexExpr> indices, ValueRange ivs);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INDEX_INDEXQUERIES_H
