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

/// The reads of a parallel loop of what other iterations write: its result
/// depends on which of them comes first.
class OtherIterations {
public:
  explicit OtherIterations(ParallelForOp loop) : loop(loop) {}

  using PairFilter = llvm::function_ref<bool(DifferentiableAccessInterface,
                                             DifferentiableAccessInterface)>;

  /// Looks at all pairs of a write and a read, but for those that are known.
  void find(ArrayRef<DifferentiableAccessInterface> writes,
            ArrayRef<DifferentiableAccessInterface> reads, PairFilter isKnown);

  bool anyCertain() const { return !certain.empty(); }
  /// Reports what certainly is a race.
  void report();
  /// Refuses the launches in which the rest is a race, where bounds and
  /// arguments decide.
  void refuseLaunches();
  /// Has the rest looked for as the loop runs.
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
