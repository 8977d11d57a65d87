//===- Rematerializer.h - Primal values in an adjoint -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The to-be-recorded analysis in its on-demand form: a primal value that a rule
// needs is recomputed in the frame of its block, with its operands and nothing
// else. Values that a serial loop carries cannot be recomputed from one
// iteration, so the loop is run once more and records them: LoopHistory.h.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_REVERSE_REMATERIALIZER_H
#define TAI_LIB_AD_REVERSE_REMATERIALIZER_H

#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "tai/AD/Reverse/AdjointBuilder.h"

namespace mlir::tai {
class ForwardReexecution;
class StoredOutputs;

class Rematerializer {
public:
  /// Creates a rematerializer that notes in `demands` the values that the
  /// adjoint needs from the primal. If `stored` is null, stored outputs are not
  /// used.
  Rematerializer(AdjointBuilder &builder, const AdjointPlan &plan,
                 PrimalDemands &demands, ForwardReexecution &reexecution,
                 StoredOutputs *stored)
      : b(builder), plan(plan), demands(demands), reexecution(reexecution),
        stored(stored) {}

  /// Returns the primal value `value`, recomputed in the frame of its block.
  Value get(Value value);
  /// Copies a primal block into `mirror` as far as its terminator needs it: the
  /// ops that compute the terminator's operands, and the terminator.
  void cloneBlock(Block *primal, Block *mirror);
  /// Checks that `read`, repeated in the adjoint, returns the value that it
  /// returned in the primal.
  bool checkReadable(DifferentiableAccessInterface read);

  /// True while a derivative rule requests primal values; false while the
  /// control flow of the adjoint does. The control flow must not depend on
  /// whether stored outputs are used, because one form of the adjoint takes
  /// over the reads of the other.
  bool isForRule = false;

private:
  Value materialize(Frame &frame, Value value);
  void materializeArgument(Frame &frame, BlockArgument argument);
  bool isOwnRead(Operation *op) const;
  bool needsOperands(Frame &frame, Operation *op,
                     SmallVectorImpl<Operation *> &missing);
  void recompute(Frame &frame, Operation *op);
  void recomputeRegions(Operation *op, Operation *copy);
  void recomputeOwners(Frame &frame, memref::AllocOp alloc);
  void setInsertionPointFor(Frame &frame, Operation *op);
  bool checkRecomputable(Operation *op);
  Value loadStored(Frame &frame, Value value);

  AdjointBuilder &b;
  const AdjointPlan &plan;
  PrimalDemands &demands;
  ForwardReexecution &reexecution;
  StoredOutputs *stored;
  /// The random draws that were repeated, and the ops that cannot be
  /// recomputed.
  DenseSet<Operation *> recomputedDraws, refused;
};

} // namespace mlir::tai

#endif // TAI_LIB_AD_REVERSE_REMATERIALIZER_H
