//===- OtherIterations.h - Reads of other iterations' writes ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_ACCUMULATIONS_OTHERITERATIONS_H
#define TAI_LIB_TRANSFORMS_ACCUMULATIONS_OTHERITERATIONS_H

#include "tai/Analysis/Races.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// True for an atomic whose result depends on all operands. Minima, maxima and
/// masks only ever come closer to their result.
bool isTotal(DifferentiableAccessInterface access);

/// Finds reads, in a parallel loop, of elements that other iterations write:
/// the result of such a read depends on which iteration comes first.
class OtherIterations {
public:
  explicit OtherIterations(ParallelForOp loop) : loop(loop) {}

  using PairFilter = llvm::function_ref<bool(DifferentiableAccessInterface,
                                             DifferentiableAccessInterface)>;

  /// Examines all pairs of a write and a read in the loop, except pairs for
  /// which `isKnown` holds. Pairs certainly conflict if the indices prove it,
  /// or `isCertain` holds.
  void find(ArrayRef<DifferentiableAccessInterface> writes,
            ArrayRef<DifferentiableAccessInterface> reads, PairFilter isKnown,
            PairFilter isCertain);

  bool anyCertain() const { return !certain.empty(); }
  /// Reports the pairs of a write and a read that certainly conflict.
  void report();
  /// Refuses launches in which a possible conflict occurs, if bounds and
  /// arguments decide this.
  void refuseLaunches();
  /// Adds code to the loop that checks for possible conflicts as the loop runs.
  void check();

private:
  struct AccessPair {
    DifferentiableAccessInterface write, read;
  };

  void checkStorage(ArrayRef<AccessPair> pairs);

  ParallelForOp loop;
  SmallVector<AccessPair> certain, possible;
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_ACCUMULATIONS_OTHERITERATIONS_H
