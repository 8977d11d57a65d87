//===- PairSums.h - Sums of f64 with twice the digits -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A compensated sum of f64 is a pair: the sum, and the sum of its rounding
// errors.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOHOST_REDUCTIONS_PAIRSUMS_H
#define TAI_LIB_CONVERSION_TAITOHOST_REDUCTIONS_PAIRSUMS_H

#include "mlir/IR/Builders.h"

namespace mlir::tai {

/// A compensated sum: a sum of f64 and the sum of its rounding errors, or
/// vectors of these.
struct Pair {
  Value sum, rest;
};

/// Emits the addition of `x` to a compensated sum (two-sum). The operations
/// have no fast-math flags.
Pair emitPairSum(OpBuilder &builder, Location loc, Pair pair, Value x);

/// Emits the value of a compensated sum: the sum of its two numbers, rounded.
Value emitRounded(OpBuilder &builder, Location loc, Pair pair);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOHOST_REDUCTIONS_PAIRSUMS_H
