//===- OldValue.h - The value of an element before a store ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The loads of the element to which a store writes, and all that is computed
// from them in the same iteration of a parallel loop.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_ACCUMULATIONS_OLDVALUE_H
#define TAI_LIB_TRANSFORMS_ACCUMULATIONS_OLDVALUE_H

#include "tai/Analysis/SharedElements.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

class OldValue {
public:
  /// Analyses the old value of the element to which `store` writes. `reads` are
  /// the reads in the loop of the storage that `store` writes.
  OldValue(DifferentiableAccessInterface store, ParallelForOp loop,
           ArrayRef<DifferentiableAccessInterface> reads,
           const SameIteration &same);

  /// True for a load of the same element that the store of this iteration
  /// writes.
  bool isLoaded(Value value) const;
  /// True for a value that is computed from the old value of the element or of
  /// a component of it.
  bool reaches(Value value) const { return dependents.contains(value); }

private:
  DifferentiableAccessInterface store;
  ParallelForOp loop;
  const SameIteration &same;
  llvm::DenseSet<Value> dependents;
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_ACCUMULATIONS_OLDVALUE_H
