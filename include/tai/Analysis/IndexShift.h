//===- IndexShift.h - Indices that are shifts of a loop index ---*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Recognises index expressions that are a loop index plus a constant, possibly
// wrapped around the end of its range, by evaluating them for each value of the
// loop index. How a program writes the wrap does not matter.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_INDEXSHIFT_H
#define TAI_ANALYSIS_INDEXSHIFT_H

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

/// The leaves of an index expression below `scope`: values defined outside of
/// it are constants to the loop; `variables` receives the arguments of its
/// block that the expression depends on. Fails if the expression holds an
/// operation that integer arithmetic cannot follow.
bool collectIndexVariables(Value index, Region &scope,
                           SmallVectorImpl<Value> &variables);

/// The value of an integer expression whose only variable is `variable`, for
/// variable = `at`; nothing if the expression is not constant otherwise, or
/// divides by zero.
std::optional<int64_t> evaluateIndex(Value index, Value variable, int64_t at);

/// A truth value that is `answer` for all values of its variable in
/// [lower, upper).
struct ConstantStretch {
  int64_t lower, upper;
  bool answer;
};

/// Where `condition`, whose only variable is `variable`, answers as it does in
/// the middle of [lower, upper); nothing if it cannot be evaluated there, or
/// the range is too long to be worth it.
std::optional<ConstantStretch> getConstantStretch(Value condition,
                                                  Value variable, int64_t lower,
                                                  int64_t upper);

/// How `index` shifts `variable` over [lower, upper); nothing if it is no
/// shift, or if the range is empty or too long to be worth the evaluation.
std::optional<IndexShift> getIndexShift(Value index, Value variable,
                                        int64_t lower, int64_t upper);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INDEXSHIFT_H
