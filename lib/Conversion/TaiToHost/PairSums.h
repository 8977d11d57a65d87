//===- PairSums.h - Sums of f64 with twice the digits -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A compensated sum of f64 is a pair: the sum, and the sum of its rounding
// errors. LLVM must not reorder such sums, and does not vectorise a loop that
// forms one. So the loop over iterations stores its terms, which LLVM
// vectorises, and after each block of iterations the terms are summed in lanes.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOHOST_PAIRSUMS_H
#define TAI_LIB_CONVERSION_TAITOHOST_PAIRSUMS_H

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// A sum of f64, and the sum of its rounding errors; or vectors of them.
struct Pair {
  Value sum, rest;
};

/// Adds `x` to the pair (two-sum). The operations have no fast-math flags.
Pair emitPairSum(OpBuilder &builder, Location loc, Pair pair, Value x);

/// The pair as one number.
Value emitRounded(OpBuilder &builder, Location loc, Pair pair);

/// A pair for each vector lane, and the terms of a block of iterations.
class PairLanes {
public:
  /// At the entry of a function, for `updates` updates in each of the `block`
  /// iterations of a block.
  PairLanes(OpBuilder &builder, Location loc, size_t updates, int64_t block);

  /// At update number `update`, in the innermost loop: stores its term. Must
  /// run in every iteration; the term of a skipped update is zero.
  void emitTerm(OpBuilder &builder, Location loc, size_t update,
                scf::ForOp loop, Value term);
  /// After that loop: sums its terms.
  void emitBlockEnd(OpBuilder &builder, Location loc, scf::ForOp loop);
  /// The sum over all lanes.
  Pair emitTotal(OpBuilder &builder, Location loc);

private:
  static constexpr int64_t kLanes = 8;
  static constexpr int64_t kVectors = 2;

  VectorType type;
  /// The buffer of terms of each update.
  SmallVector<Value> terms;
  SmallVector<Value> sums, rests;
};

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOHOST_PAIRSUMS_H
