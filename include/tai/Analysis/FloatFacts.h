//===- FloatFacts.h - Facts about floats ------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Small structural facts: is a value positive, can it be infinite or NaN. They
// decide where a derivative needs no guard and where an operation may be
// speculated.
//
// Loaded values and arguments are assumed to be finite, and so are sums and
// products of finite values: overflow is ignored, and the facts are about
// operations that make a value non-finite on ordinary input, such as a division
// by zero.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_FLOATFACTS_H
#define TAI_ANALYSIS_FLOATFACTS_H

#include "mlir/IR/Operation.h"
#include "llvm/ADT/DenseMap.h"
#include "llvm/ADT/SmallVector.h"

namespace mlir::tai {

class FloatFacts {
public:
  /// Bounds of a float value: every component that is not NaN lies within them.
  struct Interval {
    double low, high;
  };

  /// With `usesConditions`, facts may follow from the conditions of branches
  /// around a place, which is wrong for a client that may remove the branch.
  explicit FloatFacts(bool usesConditions = false)
      : usesConditions(usesConditions) {}

  /// False if `value` is proven to be finite for all finite inputs.
  bool mayBeNonFinite(Value value);

  // This query and the following ones are about each component of `value` at
  // the op `at`; conditions around `at` may be used. Positive and non-zero
  // values other than constants are far enough from zero that their inverse
  // does not overflow.
  bool isPositive(Value value, Operation *at = nullptr);
  bool isNonNegative(Value value, Operation *at = nullptr);
  bool isNonZero(Value value, Operation *at = nullptr);
  bool isNonPositive(Value value, Operation *at = nullptr);
  /// True if every component of `value` lies in [-1, 1].
  bool isInUnitInterval(Value value, Operation *at = nullptr);
  Interval getRange(Value value, Operation *at = nullptr);

  /// The least magnitude x for which both 1 / x and (1 / x)^3 are in the range
  /// of the type.
  static double getClearance(Type type);

private:
  static constexpr unsigned kDepth = 8;
  Interval getRange(Value value, Operation *at, unsigned depth);
  Interval computeRange(Value value, Operation *at, unsigned depth);
  bool computeMayBeNonFinite(Value value);

  bool usesConditions;
  llvm::DenseMap<Value, bool> nonFinite;
  /// The keys of the cache `nonFinite` whose values were found finite, in the
  /// order in which they were found.
  llvm::SmallVector<Value> concludedFinite;
};

/// True if the derivative of `op` may be infinite or NaN though its operands
/// are finite. Conservative for unknown ops.
bool mayHaveNonFinitePartial(Operation *op, FloatFacts &facts);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_FLOATFACTS_H
