//===- Rematerializer.h - Primal values in an adjoint -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The to-be-recorded analysis in its on-demand form: a primal value that a rule
// asks for is computed again in the frame of its block, with what it needs and
// nothing else. Values that a serial loop carries cannot be computed again from
// one iteration, so the loop is run once more and records them: LoopHistory.h.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_REVERSE_REMATERIALIZER_H
#define TAI_LIB_AD_REVERSE_REMATERIALIZER_H

#include "tai/AD/AdjointBuilder.h"

namespace mlir::tai {
class ForwardReexecution;
class StoredOutputs;

class Rematerializer {
public:
  /// What is asked of the primal is noted in `demands`. Without `stored`,
  /// nothing is loaded that the primal has stored.
  Rematerializer(AdjointBuilder &builder, const AdjointPlan &plan,
                 PrimalDemands &demands, ForwardReexecution &reexecution,
                 StoredOutputs *stored)
      : b(builder), plan(plan), demands(demands), reexecution(reexecution),
        stored(stored) {}

  /// The primal value, in the frame of its block.
  Value get(Value value);
  /// Mirrors a block for its primal values alone: those that its terminator
  /// passes on, and the terminator itself.
  void cloneBlock(Block *primal, Block *mirror);
  /// Checks that a read gives in the adjoint what it gave in the primal.
  bool checkReadable(DifferentiableAccessInterface read);

  /// True while a rule asks, and not what decides where an adjoint goes: that
  /// must be the same in both forms of an adjoint, for one is asked what the
  /// other reads.
  bool isForRule = false;

private:
  Value materialize(Frame &frame, Value value);
  void materializeArgument(Frame &frame, BlockArgument argument);
  bool needsOperands(Frame &frame, Operation *op,
                     SmallVectorImpl<Operation *> &missing);
  void recompute(Frame &frame, Operation *op);
  void recomputeRegions(Operation *op, Operation *copy);
  bool checkRecomputable(Operation *op);
  Value loadStored(Frame &frame, Value value);

  AdjointBuilder &b;
  const AdjointPlan &plan;
  PrimalDemands &demands;
  ForwardReexecution &reexecution;
  StoredOutputs *stored;
  /// The draws that were made once again, and the ops that cannot be.
  DenseSet<Operation *> recomputedDraws, refused;
};

} // namespace mlir::tai

#endif // TAI_LIB_AD_REVERSE_REMATERIALIZER_H
