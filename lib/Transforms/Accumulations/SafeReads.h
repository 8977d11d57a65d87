//===- SafeReads.h - Reads that any iteration may do ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `if a and b: store` computes the second condition in the branch of the first
// one. If the first condition is removed, more iterations read the operands of
// the second one: such a read must stay inside its storage, and must not race.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_ACCUMULATIONS_SAFEREADS_H
#define TAI_LIB_TRANSFORMS_ACCUMULATIONS_SAFEREADS_H

#include "tai/Analysis/SharedElements.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// Decides which reads of a loop may run in more iterations when conditions of
/// a store are removed.
class SafeReads {
public:
  /// Analyses reads around `store`. `accesses` are all accesses of the loop.
  SafeReads(DifferentiableAccessInterface store, ParallelForOp loop,
            const SameIteration &same,
            ArrayRef<DifferentiableAccessInterface> accesses)
      : store(store), loop(loop), same(same), accesses(accesses) {}

  /// True if the read `op`, which is inside of `branch`, may also run in
  /// iterations that do not take the branch.
  bool contains(Operation *op, Operation *branch) const;

private:
  bool isInside(FlatSymbolRefAttr field, ValueRange indices) const;
  bool covers(DifferentiableAccessInterface read,
              DifferentiableAccessInterface other) const;
  bool mayBeWritten(DifferentiableAccessInterface read) const;

  DifferentiableAccessInterface store;
  ParallelForOp loop;
  const SameIteration &same;
  ArrayRef<DifferentiableAccessInterface> accesses;
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_ACCUMULATIONS_SAFEREADS_H
