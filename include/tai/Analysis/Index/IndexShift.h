//===- IndexShift.h - Indices that are shifts of a loop index ---*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Recognises index expressions that are a loop index plus a constant, possibly
// wrapped around the end of its range or cut off there. The expressions are
// evaluated over ranges of the loop index in which each operation is linear:
// minima, comparisons, divisions and arithmetic that wraps end a range. How a
// program writes the wrap does not matter, nor how long the loop is.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_INDEX_INDEXSHIFT_H
#define TAI_ANALYSIS_INDEX_INDEXSHIFT_H

#include "mlir/IR/Value.h"
#include <optional>

namespace mlir::tai {

/// index(i) = i + offset for all i in [lower, upper); with `wraps`, the result
/// is taken back into [lower, upper) by adding or subtracting its length.
struct IndexShift {
  int64_t offset = 0;
  bool wraps = false;

  bool isIdentity() const { return offset == 0; }
};

/// Collects in `variables` the block arguments of `scope` that an index
/// expression depends on; values defined outside of `scope` are constants.
/// False if the expression holds an operation that is not integer arithmetic.
bool collectIndexVariables(Value index, Region &scope,
                           SmallVectorImpl<Value> &variables);

/// The value of an integer expression in the single variable `variable`, for
/// variable = `at`; none if it has other variables, or divides by zero.
std::optional<int64_t> evaluateIndex(Value index, Value variable, int64_t at);

/// index(i) = slope * i + offset for all i in [lower, upper).
struct IndexPiece {
  int64_t lower, upper;
  int64_t slope, offset;

  int64_t at(int64_t i) const { return slope * i + offset; }
};

/// The pieces of [lower, upper) on which `index`, an expression in the single
/// variable `variable`, is linear, from the first to the last; none if it has
/// too many.
std::optional<SmallVector<IndexPiece>>
getIndexPieces(Value index, Value variable, int64_t lower, int64_t upper);

/// An interval [lower, upper) of a variable in which a condition has the same
/// result, `answer`, for all values.
struct ConstantStretch {
  int64_t lower, upper;
  bool answer;
};

/// The stretch around the middle of [lower, upper) in which `condition`, an
/// expression in the single variable `variable`, does not change; none if it
/// cannot be evaluated there.
std::optional<ConstantStretch> getConstantStretch(Value condition,
                                                  Value variable, int64_t lower,
                                                  int64_t upper);

/// Describes how `index` shifts the loop index `variable` over [lower, upper);
/// none if it is not a shift, or if the range is empty.
std::optional<IndexShift> getIndexShift(Value index, Value variable,
                                        int64_t lower, int64_t upper);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INDEX_INDEXSHIFT_H
