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

/// The reads of a parallel loop of elements that other iterations write: the
/// result depends on which iteration comes first.
class OtherIterations {
public:
  explicit OtherIterations(ParallelForOp loop) : loop(loop) {}

  using PairFilter = llvm::function_ref<bool(DifferentiableAccessInterface,
                                             DifferentiableAccessInterface)>;

  /// Examines all pairs of a write and a read, except pairs for which `isKnown`
  /// holds.
  void find(ArrayRef<DifferentiableAccessInterface> writes,
            ArrayRef<DifferentiableAccessInterface> reads, PairFilter isKnown);

  bool anyCertain() const { return !certain.empty(); }
  /// Reports the pairs that certainly conflict.
  void report();
  /// Refuses launches in which a possible conflict occurs, where bounds and
  /// arguments decide that.
  void refuseLaunches();
  /// Makes the loop check for possible conflicts as it runs.
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
