//===- ForwardReexecution.h - Executing the primal again --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Where neither what a field held before a launch nor what it holds afterwards
// is all that the reverse needs, the block is executed forward again on what
// was there before, with its stores to such fields. So are random draws in
// serial loops, which must come in the same order. What the reverse asks for is
// pushed on a stack, one for each value, when the second execution computes it;
// the reverse pops it where the mirror of the same block begins. Each execution
// of a block pushes once and each reversed execution pops once, so that the
// orders agree however loops and branches are nested.
//
// All else is rematerialised from what is popped, as it is elsewhere.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_REVERSE_FORWARDREEXECUTION_H
#define TAI_LIB_AD_REVERSE_FORWARDREEXECUTION_H

#include "mlir/IR/IRMapping.h"
#include "tai/AD/AdjointBuilder.h"

namespace mlir::tai {

/// One block of the primal that is executed again, at the start of its mirror,
/// and what it records.
struct ReexecutedBlock {
  ReexecutedBlock(Frame &frame, std::unique_ptr<ReexecutedBlock> parent)
      : frame(frame), parent(std::move(parent)) {}

  /// A recorded value: the primal block whose mirrors pop it, and one stack for
  /// each component.
  struct Record {
    Block *block;
    SmallVector<Value> stacks;
  };
  /// A mirror that has been left, with the op that marks where values are
  /// popped.
  struct Mirror {
    Block *block;
    Operation *marker;
    DenseSet<Value> popped;
  };

  Frame &frame;
  /// That of a block around this one.
  std::unique_ptr<ReexecutedBlock> parent;
  /// Stacks are made before this op, which only marks the place.
  Operation *begin = nullptr;
  /// What primal values of the block, and of the blocks in it, are in the
  /// second execution.
  IRMapping values;
  /// How often the second region of a loop has run.
  DenseMap<Operation *, Value> counts;
  llvm::MapVector<Value, Record> records;
  SmallVector<Mirror> mirrors;
};

/// Emits what a ReexecutionPlan says.
class ForwardReexecution {
public:
  ForwardReexecution(AdjointBuilder &builder, const ReexecutionPlan &plan)
      : b(builder), plan(plan) {}

  /// At the start and at the end of the mirror of a block that is executed
  /// again.
  void begin(Frame &frame);
  void end(Frame &frame);
  /// Where any mirror ends: other mirrors of the block may still ask for values
  /// that this one must then pop as well.
  void leave(Frame &frame);

  /// The value that stands for a recorded one, in the mirror of its block.
  Value fetch(Frame &frame, Value value);
  /// How often the second region of a loop around recorded ops has run.
  Value fetchCount(scf::WhileOp loop);

  /// Adds the reads that something in the adjoint needs to those that it makes,
  /// and erases the others.
  void collectReads(FunctionOpInterface adjoint, PrimalDemands &demands);

private:
  AdjointBuilder &b;
  const ReexecutionPlan &plan;
  /// The innermost block that is being executed again.
  std::unique_ptr<ReexecutedBlock> innermost;
  /// The reads that those marked with an attribute repeat.
  SmallVector<Operation *> reads;
};

} // namespace mlir::tai

#endif // TAI_LIB_AD_REVERSE_FORWARDREEXECUTION_H
