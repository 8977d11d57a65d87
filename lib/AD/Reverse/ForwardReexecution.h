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
#include "tai/AD/Reverse/AdjointBuilder.h"

namespace mlir::tai {

/// A primal block that is executed again at the start of its mirror (the
/// corresponding block of the adjoint), and the values recorded on the way.
struct ReexecutedBlock {
  ReexecutedBlock(Frame &frame, std::unique_ptr<ReexecutedBlock> parent)
      : frame(frame), parent(std::move(parent)) {}

  /// A value recorded on stacks: the primal block at the start of whose mirrors
  /// it is popped, and one stack for each component.
  struct Record {
    Block *block;
    SmallVector<Value> stacks;
  };
  /// A completed mirror of a primal block, and the op in it that marks where
  /// recorded values are popped.
  struct Mirror {
    Block *block;
    Operation *marker;
    DenseSet<Value> popped;
  };

  Frame &frame;
  /// The enclosing re-executed block, or null.
  std::unique_ptr<ReexecutedBlock> parent;
  /// A placeholder op at the start of the block, before which the stacks are
  /// created.
  Operation *begin = nullptr;
  /// Maps values of the primal block, and of blocks nested in it, to the values
  /// of the second execution.
  IRMapping values;
  /// For each re-executed scf.while: the number of times that its second region
  /// ran.
  DenseMap<Operation *, Value> counts;
  llvm::MapVector<Value, Record> records;
  SmallVector<Mirror> mirrors;
};

/// Emits the second execution of primal ops that a ReexecutionPlan asks for.
class ForwardReexecution {
public:
  ForwardReexecution(AdjointBuilder &builder, const ReexecutionPlan &plan)
      : b(builder), plan(plan) {}

  /// To be called at the start and at the end of the mirror of each re-executed
  /// block.
  void begin(Frame &frame);
  void end(Frame &frame);
  /// To be called at the end of every mirror. Another mirror of the same block
  /// may record further values later, which this mirror must then pop as well.
  void leave(Frame &frame);

  /// Returns the recorded value of the primal value `value`, popped at the
  /// start of the mirror of the value's block.
  Value fetch(Frame &frame, Value value);
  /// Returns the number of times that the second region of `loop` ran in the
  /// second execution; `loop` contains recorded ops.
  Value fetchCount(scf::WhileOp loop);

  /// Adds the reads of the second execution that the adjoint uses to `demands`,
  /// and erases the unused reads.
  void collectReads(FunctionOpInterface adjoint, PrimalDemands &demands);

private:
  AdjointBuilder &b;
  const ReexecutionPlan &plan;
  /// The innermost primal block that is being re-executed.
  std::unique_ptr<ReexecutedBlock> innermost;
  /// The primal reads that are repeated. The repeated read has the index of its
  /// primal read in this list as an attribute.
  SmallVector<Operation *> reads;
};

} // namespace mlir::tai

#endif // TAI_LIB_AD_REVERSE_FORWARDREEXECUTION_H
