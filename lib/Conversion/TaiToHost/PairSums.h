//===- PairSums.h - Sums of f64 with twice the digits -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A compensated sum of f64 is a pair: the sum, and the sum of what it has
// rounded away. LLVM may not reorder such sums, and vectorises no loop that
// forms one. So a loop over iterations stores its terms, which LLVM vectorises,
// and behind each block of iterations they are added up in lanes.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOHOST_PAIRSUMS_H
#define TAI_LIB_CONVERSION_TAITOHOST_PAIRSUMS_H

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// A sum of f64, and the sum of what that has rounded away; or vectors of them.
struct Pair {
  Value sum, rest;
};

/// The pair with a number more. Its operations have no flags of floats, and the
/// number is not fused into one of them.
Pair emitPairSum(OpBuilder &builder, Location loc, Pair pair, Value x);

/// Whether all these updates are made at most once in an iteration of the
/// innermost loop that takes the place of `loop`, by that loop.
bool areMadeOnce(ArrayRef<Operation *> updates, ParallelForOp loop);

/// A pair in lanes, and the terms of a block of iterations.
class PairLanes {
public:
  /// Iterations of a block. Their terms stay in the first cache.
  static constexpr int64_t kBlock = 1024;

  /// Whether these updates can be summed so, and are worth the memory.
  static bool canHold(ArrayRef<Operation *> updates, ParallelForOp loop);

  /// At the entry of a function, for so many updates of an iteration.
  PairLanes(OpBuilder &builder, Location loc, size_t updates);

  /// At an update, in the innermost loop: keeps its term. A term that is not
  /// there must be a zero.
  void emitTerm(OpBuilder &builder, Location loc, size_t update,
                scf::ForOp loop, Value term);
  /// Behind that loop: adds its terms up.
  void emitBlockEnd(OpBuilder &builder, Location loc, scf::ForOp loop);
  /// The pair of all lanes.
  Pair emitTotal(OpBuilder &builder, Location loc);

private:
  static constexpr int64_t kLanes = 8;
  static constexpr int64_t kVectors = 2;

  VectorType type;
  /// Of each update.
  SmallVector<Value> terms;
  SmallVector<Value> sums, rests;
};

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOHOST_PAIRSUMS_H
