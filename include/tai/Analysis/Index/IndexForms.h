//===- IndexForms.h - Indices as linear sums --------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Integer values of a kernel as linear sums, and their ranges: sums of loop
// indices and of launch values, which depend on the arguments of the kernel and
// the extents of its arrays alone. Integers wrap around, sums do not: unless a
// value provably does not wrap, the form records that as an assumption.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_INDEX_INDEXFORMS_H
#define TAI_ANALYSIS_INDEX_INDEXFORMS_H

#include "tai/Analysis/Index/IntegerRanges.h"
#include "tai/Analysis/Index/LinearSystem.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/DenseMap.h"
#include <optional>

namespace mlir::tai {

/// A closed interval. The extremes of int64_t mean unbounded.
struct NumberRange {
  int64_t low = INT64_MIN, high = INT64_MAX;

  bool isBounded() const { return low != INT64_MIN && high != INT64_MAX; }
  bool isWithin(NumberRange other) const {
    return low >= other.low && high <= other.high;
  }
};

/// A number that the host can compute before the kernel runs: a value, the
/// extent of dimension `dimension` of `array`, or the product of two sums of
/// launch values.
struct LaunchValue {
  Value value, array;
  int64_t dimension = 0;
  SmallVector<LinearSum, 0> factors = {};
};

/// An integer value as a linear sum of variables, with inequalities that hold
/// for these variables.
struct LinearForm {
  LinearSum sum;
  SmallVector<LinearSum, 2> facts;
  /// True if the sum certainly equals the value and is a function of the
  /// iteration.
  bool isCertain = true;
  /// True if the inequalities `facts` (each states that a sum is >= 0) always
  /// hold; if false, they are assumptions.
  bool isComplete = true;

  /// Returns the linear form of this value plus `scale` times `other`.
  LinearForm plus(const LinearForm &other, int64_t scale) const;
};

/// The forms of the values of a kernel, and their variables.
class IndexForms {
public:
  enum class Kind { Launch, Loop, Quotient, Product, Data };

  explicit IndexForms(KernelOp kernel);

  LinearForm formOf(Value value);
  NumberRange rangeOf(Value value);
  NumberRange rangeOfSum(const LinearSum &sum) const;
  /// True if the value can be computed before the kernel runs.
  bool isLaunchValue(Value value);
  LinearForm makeLaunchForm(const LaunchValue &launch, NumberRange range);

  Kind getKind(unsigned variable) const { return variables[variable].kind; }
  NumberRange getRange(unsigned variable) const {
    return variables[variable].range;
  }
  /// The launch value that a variable stands for, or null.
  const LaunchValue *getLaunchValue(unsigned variable) const;
  /// The two factors of a variable that stands for a product: a sum of launch
  /// values, and a sum that varies in a loop. Empty for other variables.
  ArrayRef<LinearSum> getFactors(unsigned variable) const {
    return variables[variable].factors;
  }
  bool isOfLaunch(const LinearSum &sum) const;
  /// Drops from `system`, in which `index` goes out of range, the assumption
  /// that launch values are as small as sizes of storage, if `index` goes out
  /// of range for all larger launch values too.
  LinearSystem dropAssumptions(const LinearSystem &system,
                               const LinearSum &index) const;
  bool hasProduct(const LinearSum &sum) const;
  /// A linear sum that stands for the product of two sums of launch values,
  /// which is a launch value too. Adds to `facts` the conditions under which
  /// the product does not overflow.
  LinearSum multiply(const LinearSum &a, const LinearSum &b,
                     SmallVectorImpl<LinearSum> &facts);

private:
  struct Variable {
    Kind kind;
    NumberRange range;
    LaunchValue launch = {};
    /// For a variable of kind Product: the two sums that are multiplied.
    SmallVector<LinearSum, 0> factors = {};
  };

  LinearForm makeForm(Value value);
  LinearForm makeLoopForm(BlockArgument argument);
  std::optional<LinearForm> makeLinear(Operation *op);
  std::optional<LinearForm> makeQuotient(Operation *op);
  std::optional<LinearForm> makeExtreme(Operation *op);
  std::optional<LinearForm> makeProduct(Operation *op);
  LinearForm makeVariable(Kind kind, NumberRange range);
  /// Adds to `form` the conditions under which a value of `type` has not
  /// wrapped.
  void assumeFits(LinearForm &form, Type type) const;

  KernelOp kernel;
  IntegerRanges ranges;
  std::vector<Variable> variables;
  llvm::DenseMap<Value, LinearForm> forms;
  llvm::DenseMap<Value, bool> launchValues;
  llvm::DenseMap<std::pair<Value, int64_t>, unsigned> extentVariables;
};

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INDEX_INDEXFORMS_H
