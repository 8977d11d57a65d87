//===- IndexBuilder.h - Index expressions of a program ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The only code that decomposes index arithmetic. A builder caches the
// expressions and ranges of the values that it has met: use one builder for all
// queries on a program that does not change between the queries.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_INDEX_INDEXBUILDER_H
#define TAI_ANALYSIS_INDEX_INDEXBUILDER_H

#include "tai/Analysis/Index/IndexExpr.h"
#include "tai/Analysis/Index/IntegerRanges.h"

namespace mlir::tai {

class IndexBuilder {
public:
  /// Values defined outside of `scope`, if it is given, become terms.
  explicit IndexBuilder(Operation *scope = nullptr) : scope(scope) {}

  /// The expression of an integer or index value.
  IndexExpr get(Value value);
  SmallVector<IndexExpr> get(ValueRange values);

  IndexRange getRange(const IndexAtom &atom);
  /// The range of the sum, before any bits are dropped.
  IndexRange getRange(const IndexExpr &expr);

  /// ⌊lhs / rhs⌋ and the rest, for exact sums.
  IndexExpr getQuotient(const IndexExpr &lhs, const IndexExpr &rhs);
  IndexExpr getRemainder(const IndexExpr &lhs, const IndexExpr &rhs);
  /// Splits `expr` into `divisor` times a sum and a rest from 0 to divisor - 1.
  std::optional<std::pair<IndexExpr, IndexExpr>> split(const IndexExpr &expr,
                                                       int64_t divisor);
  /// The quotient of the division of which `rest` is the remainder.
  IndexExpr getQuotientOf(const IndexNode &rest);

private:
  /// A sum as a multiple of a divisor and a rest; `isDigit` if the rest is from
  /// 0 to the divisor - 1.
  struct Parts {
    IndexExpr multiple, rest;
    bool isDigit = false;
  };
  Parts takeMultiples(const IndexExpr &expr, int64_t divisor);
  IndexExpr build(Value value, unsigned depth);
  /// Like build, but gives the value as a term if its expression does not
  /// determine all bits of its type, or may wrap.
  IndexExpr buildWhole(Value value, unsigned depth);
  IndexExpr buildExact(Value value, unsigned depth);
  std::optional<IndexExpr> buildSum(Operation *op, unsigned depth);
  std::optional<IndexExpr> buildProduct(Operation *op, unsigned depth);
  std::optional<IndexExpr> buildCast(Operation *op, unsigned depth);
  std::optional<IndexExpr> buildDivision(Operation *op, unsigned depth);
  std::optional<IndexExpr> buildBits(Operation *op, unsigned depth);
  std::optional<IndexExpr> buildSelect(Operation *op, unsigned depth);
  std::optional<IndexExpr> buildExtreme(Operation *op, unsigned depth);
  /// Limits `expr` to the width of `type`, the type of the op that computes it,
  /// unless `fits` says that the op never wraps.
  IndexExpr limit(IndexExpr expr, Type type, llvm::function_ref<bool()> fits);
  IndexRange getSignedRange(Value value);

  /// Replaces q d + r, of the quotient and the remainder of one division, by
  /// the dividend.
  IndexExpr joinDigits(IndexExpr expr);

  Operation *scope;
  IntegerRanges ranges;
  llvm::DenseMap<Value, IndexExpr> known;
  /// Expressions that the depth limit cut short, during one call of get.
  llvm::DenseMap<Value, IndexExpr> cut;
  bool isCut = false;
};

/// As IndexBuilder::get, with a new builder.
IndexExpr getIndexExpr(Value value);
SmallVector<IndexExpr> getIndexExprs(ValueRange values);

/// A summand of an index: `whole`, which is `factor` times `value`.
struct IndexSummand {
  Value whole, value;
  int64_t factor = 1;
};

/// The summands of an index, as the program adds them.
SmallVector<IndexSummand> getSummands(Value index);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INDEX_INDEXBUILDER_H
