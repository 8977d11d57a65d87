//===- FloatFacts.h - What is known about a float ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Small structural facts: is a value positive, can it be infinite or NaN. They
// say where a derivative needs no guard and where an operation may run though
// the program would not have run it.
//
// What is loaded or passed in is taken as finite, and so are sums and products
// of finite values: the facts ask which operations make a value non-finite on
// ordinary input, such as a division by zero.
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
  /// Between these two lies every component, if it is a number.
  struct Interval {
    double low, high;
  };

  /// With `usesConditions`, what the branches around a place say counts; not so
  /// for one who asks whether the branch can go.
  explicit FloatFacts(bool usesConditions = false)
      : usesConditions(usesConditions) {}

  /// False if the value is finite wherever what it is computed from is.
  bool mayBeNonFinite(Value value);

  // Of each component, as seen from the place `at`. What is positive or not
  // zero is so clearly: an inverse does not overflow. (A constant is what it
  // is.)
  bool isPositive(Value value, Operation *at = nullptr);
  bool isNonNegative(Value value, Operation *at = nullptr);
  bool isNonZero(Value value, Operation *at = nullptr);
  bool isNonPositive(Value value, Operation *at = nullptr);
  /// True if every component lies in [-1, 1].
  bool isInUnitInterval(Value value, Operation *at = nullptr);
  Interval getRange(Value value, Operation *at = nullptr);

  /// What is at least this far from zero can be divided by, and cubed, without
  /// leaving the range of the type.
  static double getClearance(Type type);

private:
  static constexpr unsigned kDepth = 8;
  Interval getRange(Value value, Operation *at, unsigned depth);
  Interval computeRange(Value value, Operation *at, unsigned depth);
  bool computeMayBeNonFinite(Value value);

  bool usesConditions;
  llvm::DenseMap<Value, bool> nonFinite;
  /// The values that it has as finite, in the order of the answers.
  llvm::SmallVector<Value> concludedFinite;
};

/// True if the derivative of `op` may be infinite or NaN though its operands
/// are finite. Unknown ops of floats may.
bool mayHaveNonFinitePartial(Operation *op, FloatFacts &facts);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_FLOATFACTS_H
