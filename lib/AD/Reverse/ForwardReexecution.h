//===- ForwardReexecution.h - Re-executing the primal -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Where neither the version of a field before a launch nor the one after it
// holds all values that the reverse needs, the block is re-executed on the
// version before, with its stores to such fields. Random draws in serial loops
// are re-executed as well, because their order must not change. Re-execution
// pushes each value that the reverse needs on a stack of its own; the reverse
// pops the value at the start of the mirror of the value's block. Each
// execution of a block pushes once and each reversed execution pops once, so
// that the orders agree however loops and branches are nested.
//
// All other values are rematerialised from the popped ones.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_REVERSE_FORWARDREEXECUTION_H
#define TAI_LIB_AD_REVERSE_FORWARDREEXECUTION_H

#include "mlir/IR/IRMapping.h"
#include "tai/AD/AdjointBuilder.h"

namespace mlir::tai {

/// A primal block that is re-executed at the start of its mirror, and the
/// values that it records.
struct ReexecutedBlock {
  ReexecutedBlock(Frame &frame, std::unique_ptr<ReexecutedBlock> parent)
      : frame(frame), parent(std::move(parent)) {}

  /// A recorded value: the primal block whose mirrors pop it, and one stack for
  /// each component.
  struct Record {
    Block *block;
    SmallVector<Value> stacks;
  };
  /// A completed mirror, with the op that marks where it pops values.
  struct Mirror {
    Block *block;
    Operation *marker;
    DenseSet<Value> popped;
  };

  Frame &frame;
  /// The re-executed block around this one, if any.
  std::unique_ptr<ReexecutedBlock> parent;
  /// A placeholder op; stacks are created before it.
  Operation *begin = nullptr;
  /// Maps primal values of the block, and of blocks in it, to those of the
  /// re-execution.
  IRMapping values;
  /// By loop: the number of times that its second region ran.
  DenseMap<Operation *, Value> counts;
  llvm::MapVector<Value, Record> records;
  SmallVector<Mirror> mirrors;
};

/// Emits the operations of a ReexecutionPlan.
class ForwardReexecution {
public:
  ForwardReexecution(AdjointBuilder &builder, const ReexecutionPlan &plan)
      : b(builder), plan(plan) {}

  /// Call at the start and at the end of the mirror of a re-executed block.
  void begin(Frame &frame);
  void end(Frame &frame);
  /// Call at the end of any mirror: other mirrors of the block may still record
  /// values, which this one must then pop as well.
  void leave(Frame &frame);

  /// The recorded value `value`, popped at the start of the mirror of its
  /// block.
  Value fetch(Frame &frame, Value value);
  /// The number of times that the second region of a loop around recorded ops
  /// ran.
  Value fetchCount(scf::WhileOp loop);

  /// Adds the re-executed reads that the adjoint uses to `demands`, and erases
  /// the unused ones.
  void collectReads(FunctionOpInterface adjoint, PrimalDemands &demands);

private:
  AdjointBuilder &b;
  const ReexecutionPlan &plan;
  /// The innermost block that is being re-executed.
  std::unique_ptr<ReexecutedBlock> innermost;
  /// The primal reads. Each re-executed read has an attribute with the index in
  /// this list of the read that it repeats.
  SmallVector<Operation *> reads;
};

} // namespace mlir::tai

#endif // TAI_LIB_AD_REVERSE_FORWARDREEXECUTION_H
