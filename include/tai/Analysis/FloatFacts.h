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

#include "mlir/IR/Value.h"
#include "llvm/ADT/DenseMap.h"
#include "llvm/ADT/SmallVector.h"

namespace mlir::tai {

class FloatFacts {
public:
  /// False if the value is finite wherever what it is computed from is.
  bool mayBeNonFinite(Value value);
  /// True if every component is > 0.
  bool isPositive(Value value) { return isPositive(value, kDepth); }
  /// True if every component is >= 0.
  bool isNonNegative(Value value) { return isNonNegative(value, kDepth); }
  /// True if no component is 0.
  bool isNonZero(Value value);
  /// True if every component is <= 0.
  bool isNonPositive(Value value);
  /// True if every component lies in [-1, 1].
  bool isInUnitInterval(Value value);

private:
  static constexpr unsigned kDepth = 8;
  bool isPositive(Value value, unsigned depth);
  bool isNonNegative(Value value, unsigned depth);
  bool computeMayBeNonFinite(Value value);

  llvm::DenseMap<Value, bool> nonFinite;
  /// The values that it has as finite, in the order of the answers.
  llvm::SmallVector<Value> concludedFinite;
};

/// True if the derivative of `op` may be infinite or NaN though its operands
/// are finite. Unknown ops of floats may.
bool mayHaveNonFinitePartial(Operation *op, FloatFacts &facts);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_FLOATFACTS_H
