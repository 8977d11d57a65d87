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
  /// Creates a builder. With `scope`, values defined outside of this op are not
  /// decomposed: each becomes a term of the expressions.
  explicit IndexBuilder(Operation *scope = nullptr) : scope(scope) {}

  /// Returns the index expression of an integer or index value.
  IndexExpr get(Value value);
  SmallVector<IndexExpr> get(ValueRange values);

  IndexRange getRange(const IndexAtom &atom);
  /// The range of the expression's sum as an integer, before the sum is reduced
  /// to the expression's width.
  IndexRange getRange(const IndexExpr &expr);

  /// The quotient ⌊lhs / rhs⌋ and the remainder of two exact expressions.
  IndexExpr getQuotient(const IndexExpr &lhs, const IndexExpr &rhs);
  IndexExpr getRemainder(const IndexExpr &lhs, const IndexExpr &rhs);
  /// Splits `expr` into a multiple of `divisor` and a remainder from 0 to
  /// divisor - 1; returns the factor and the remainder.
  std::optional<std::pair<IndexExpr, IndexExpr>> split(const IndexExpr &expr,
                                                       int64_t divisor);
  /// Given a remainder node, builds the quotient of the same dividend and
  /// divisor.
  IndexExpr getQuotientOf(const IndexNode &rest);

private:
  /// A sum as a multiple of a divisor and a remainder; `isDigit` if the
  /// remainder is from 0 to the divisor - 1.
  struct Parts {
    IndexExpr multiple, rest;
    bool isDigit = false;
  };
  Parts takeMultiples(const IndexExpr &expr, int64_t divisor);
  IndexExpr build(Value value, unsigned depth);
  /// Like build(), but returns `value` itself as a term where its expression
  /// may wrap or does not determine all bits of the type.
  IndexExpr buildWhole(Value value, unsigned depth);
  IndexExpr buildExact(Value value, unsigned depth);
  std::optional<IndexExpr> buildSum(Operation *op, unsigned depth);
  std::optional<IndexExpr> buildProduct(Operation *op, unsigned depth);
  std::optional<IndexExpr> buildCast(Operation *op, unsigned depth);
  std::optional<IndexExpr> buildDivision(Operation *op, unsigned depth);
  std::optional<IndexExpr> buildBits(Operation *op, unsigned depth);
  std::optional<IndexExpr> buildSelect(Operation *op, unsigned depth);
  std::optional<IndexExpr> buildExtreme(Operation *op, unsigned depth);
  /// Limits the width of `expr` to the width of `type`, the type of the op that
  /// computes the value, unless `fits` says that the op never wraps.
  IndexExpr limit(IndexExpr expr, Type type, llvm::function_ref<bool()> fits);
  IndexRange getSignedRange(Value value);

  /// Replaces q * d + r by the dividend, where q and r are the quotient and the
  /// remainder of one division by d.
  IndexExpr joinDigits(IndexExpr expr);

  Operation *scope;
  IntegerRanges ranges;
  llvm::DenseMap<Value, IndexExpr> known;
  /// Caches values whose expression the depth limit cut short. The cache is
  /// kept for one call of IndexBuilder::get only, because less deep calls give
  /// better expressions.
  llvm::DenseMap<Value, IndexExpr> cut;
  bool isCut = false;
};

/// Returns the index expression of an integer or index value, from a temporary
/// IndexBuilder.
IndexExpr getIndexExpr(Value value);
SmallVector<IndexExpr> getIndexExprs(ValueRange values);

/// A summand of an index: the value `whole`, which equals `factor` times
/// `value`.
struct IndexSummand {
  Value whole, value;
  int64_t factor = 1;
};

/// Splits an index into summands, along the additions in the program.
SmallVector<IndexSummand> getSummands(Value index);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INDEX_INDEXBUILDER_H
