//===- IndexExpr.h - Index expressions --------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Index arithmetic in one form: a sum of atoms times constants. An atom is a
// value of the program, or a quotient, remainder, product, minimum or maximum
// of such sums. See docs/decisions/0057-index-expressions.md.
//
// Integers of a fixed width wrap around, sums do not. An expression says how
// many low bits of its sum determine the value: 64 where the arithmetic is
// known not to wrap, and the width of the narrowest arithmetic otherwise. The
// queries compute modulo two to the power of this width, so that their answers
// hold for arithmetic that wraps, too.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_INDEX_INDEXEXPR_H
#define TAI_ANALYSIS_INDEX_INDEXEXPR_H

#include "mlir/IR/Value.h"
#include <memory>
#include <optional>

namespace mlir::tai {
struct IndexNode;

/// A term of a sum: a value of the program, or an operation on sums.
class IndexAtom {
public:
  IndexAtom(Value value) : value(value) {}
  IndexAtom(IndexNode node);

  /// The program value that this atom is; null if the atom is an operation on
  /// sums.
  Value getValue() const { return value; }
  /// The operation that this atom is; null if the atom is a program value.
  const IndexNode *getNode() const { return node.get(); }

  /// True if `predicate` holds for all program values that occur in the atom.
  bool allOf(llvm::function_ref<bool(Value)> predicate) const;
  bool mentions(Value wanted) const;

  /// A total order of atoms, by structure; negative, zero or positive.
  int compare(const IndexAtom &other) const;
  bool operator==(const IndexAtom &other) const { return compare(other) == 0; }

private:
  Value value;
  std::shared_ptr<const IndexNode> node;
};

/// A sum of atoms times factors, and a constant.
struct IndexExpr {
  /// The summands: pairs of an atom and its factor, sorted by atom, without
  /// zero factors. Factors and the constant are numbers modulo 2^64.
  SmallVector<std::pair<IndexAtom, int64_t>, 2> terms;
  int64_t constant = 0;
  /// The number of low bits that the sum determines: the value and the sum
  /// agree modulo 2^width.
  unsigned width = 64;

  IndexExpr() = default;
  explicit IndexExpr(int64_t constant) : constant(constant) {}
  explicit IndexExpr(IndexAtom atom) { terms.emplace_back(std::move(atom), 1); }
  explicit IndexExpr(Value value) : IndexExpr(IndexAtom(value)) {}
  explicit IndexExpr(IndexNode node);

  /// True if the sum equals the value exactly: no arithmetic that computes the
  /// value wrapped.
  bool isExact() const { return width == 64; }
  bool isConstant() const { return terms.empty(); }

  /// Adds `scale` times `other` to this expression. The width of the result is
  /// the smaller of the two widths.
  IndexExpr &add(const IndexExpr &other, int64_t scale = 1);

  /// The number of occurrences of values in the expression, a measure of its
  /// size.
  unsigned getSize() const;
  /// The factor of `value` in the sum, counting only the term that is `value`
  /// itself; values within operations do not count.
  int64_t getCoefficient(Value value) const;
  bool allOf(llvm::function_ref<bool(Value)> predicate) const;
  bool mentions(Value value) const;

  /// Replaces each value for which `replace` returns an expression. For a value
  /// whose expression is not exact, `replace` must return the value itself as a
  /// term.
  IndexExpr
  substitute(llvm::function_ref<std::optional<IndexExpr>(Value)> replace) const;

  bool operator==(const IndexExpr &other) const {
    return width == other.width && compare(other) == 0;
  }
  /// A total order of the sums, without their widths.
  int compare(const IndexExpr &other) const;
};

/// An operation on two sums as integers. Quotient rounds down, and
/// TruncatedQuotient towards zero; Remainder has the sign of the divisor, and
/// TruncatedRemainder the sign of the dividend.
struct IndexNode {
  enum class Kind {
    Quotient,
    Remainder,
    TruncatedQuotient,
    TruncatedRemainder,
    Product,
    Min,
    Max
  };
  Kind kind;
  IndexExpr lhs, rhs;

  bool isRemainder() const {
    return kind == Kind::Remainder || kind == Kind::TruncatedRemainder;
  }
  bool isDivision() const { return kind < Kind::Product; }
  unsigned size = lhs.getSize() + rhs.getSize();
};

/// The closed range of a sum.
struct IndexRange {
  __int128 low, high;

  bool fits(unsigned width) const {
    __int128 half = static_cast<__int128>(1) << (width - 1);
    return low >= -half && high < half;
  }
};

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INDEX_INDEXEXPR_H
