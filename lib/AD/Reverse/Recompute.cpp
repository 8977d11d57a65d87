//===- Recompute.cpp - Primal values in the adjoint kernel ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The to-be-recorded analysis in its on-demand form: a primal value that a rule
// asks for is computed again in the frame of its block, with what it needs and
// nothing else. Values that a serial loop carries cannot be computed again from
// one iteration, so the loop is run once more and records them.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "tai/AD/AdjointBuilder.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

Value AdjointBuilder::getPrimal(Value value) {
  Block *block = value.getParentBlock();
  Frame *frame = current;
  while (frame && frame->primal != block)
    frame = frame->parent;
  assert(frame && "a primal value is asked for outside of its block");
  if (Value known = frame->values.lookupOrNull(value))
    return known;
  return materialize(*frame, value);
}

SmallVector<Value> AdjointBuilder::getPrimals(ValueRange values) {
  return llvm::map_to_vector(values,
                             [&](Value value) { return getPrimal(value); });
}

/// Appends the ops of this block that `op` needs and that are not recomputed
/// yet. Returns true if there are any.
bool AdjointBuilder::needsOperands(Frame &frame, Operation *op,
                                   SmallVectorImpl<Operation *> &missing) {
  size_t before = missing.size();
  for (Value operand : op->getOperands())
    if (operand.getParentBlock() == frame.primal && operand.getDefiningOp() &&
        !frame.values.contains(operand)) {
      if (isRecorded(operand))
        frame.values.map(operand, fetchRecorded(frame, operand));
      else if (Value kept = fetchStored(frame, operand))
        frame.values.map(operand, kept);
      else
        missing.push_back(operand.getDefiningOp());
    }
  return missing.size() != before;
}

Value AdjointBuilder::materialize(Frame &frame, Value value) {
  OpBuilder::InsertionGuard guard(*this);
  Location loc = getLoc();
  Frame *saved = current;
  current = &frame;
  if (auto argument = dyn_cast<BlockArgument>(value)) {
    materializeArgument(frame, argument);
  } else if (isRecorded(value)) {
    frame.values.map(value, fetchRecorded(frame, value));
  } else if (Value kept = fetchStored(frame, value)) {
    frame.values.map(value, kept);
  } else {
    // A list of pending ops and not recursion: chains can be long.
    SmallVector<Operation *> pending = {value.getDefiningOp()};
    while (!pending.empty()) {
      Operation *op = pending.back();
      if (frame.recomputed.count(op) || refused.contains(op)) {
        pending.pop_back();
      } else if (!needsOperands(frame, op, pending)) {
        pending.pop_back();
        recompute(frame, op);
      }
    }
  }
  current = saved;
  setLoc(loc);
  // After an error the value itself stands in: the adjoint will be discarded.
  if (!frame.values.contains(value))
    frame.values.map(value, value);
  return frame.values.lookup(value);
}

void AdjointBuilder::recompute(Frame &frame, Operation *op) {
  if (!checkRecomputable(op)) {
    for (Value result : op->getResults())
      frame.values.map(result, result);
    refused.insert(op);
    return;
  }
  // Operands may lie in outer frames, and be recomputed there.
  IRMapping mapping;
  for (Value operand : op->getOperands())
    mapping.map(operand, getPrimal(operand));
  auto next = frame.recomputed.lower_bound(op);
  if (next != frame.recomputed.end())
    setInsertionPoint(next->second);
  else if (frame.sweepBegin)
    setInsertionPoint(frame.sweepBegin);
  else
    setInsertionPointToEnd(frame.mirror);
  setLoc(op->getLoc());
  Operation *copy = insert(op->cloneWithoutRegions(mapping));
  for (auto [from, to] : llvm::zip(op->getResults(), copy->getResults()))
    frame.values.map(from, to);
  // What the regions capture is recomputed before the op: it must be known
  // where the op stands.
  frame.recomputed[op] = copy;
  if (op->getNumRegions() != 0)
    recomputeRegions(op, copy);
}

void AdjointBuilder::recomputeRegions(Operation *op, Operation *copy) {
  OpBuilder::InsertionGuard guard(*this);
  for (auto [from, to] : llvm::zip(op->getRegions(), copy->getRegions())) {
    if (from.empty())
      continue;
    Block *mirror = createBlock(&to);
    for (BlockArgument argument : from.front().getArguments())
      mirror->addArgument(argument.getType(), argument.getLoc());
    recomputeBlock(&from.front(), mirror);
  }
}

void AdjointBuilder::recomputeBlock(Block *primal, Block *mirror) {
  Frame frame(current, primal, mirror);
  for (auto [from, to] :
       llvm::zip(primal->getArguments(), mirror->getArguments()))
    frame.values.map(from, to);
  current = &frame;
  Operation *terminator = primal->getTerminator();
  IRMapping mapping;
  for (Value operand : terminator->getOperands())
    mapping.map(operand, getPrimal(operand));
  setInsertionPointToEnd(mirror);
  clone(*terminator, mapping);
  current = frame.parent;
}

/// True if some loop around `op` runs its iterations one after another.
static bool isInSerialLoop(Operation *op) {
  for (Operation *parent = op->getParentOp();
       parent && !isa<FunctionOpInterface>(parent);
       parent = parent->getParentOp())
    if (isa<LoopLikeOpInterface>(parent) &&
        !isa<ParallelForOp, scf::ParallelOp>(parent))
      return true;
  return false;
}

bool AdjointBuilder::checkRecomputable(Operation *op) {
  if (op->getNumRegions() != 0) {
    if (llvm::all_of(op->getRegions(), [](Region &region) {
          return region.empty() || region.hasOneBlock();
        }))
      return true;
    emitError(op, "'" + op->getName().getStringRef() +
                      "' has several blocks and is needed by the gradient; "
                      "structured control flow is expected");
    return false;
  }
  if (isa<RandomOp>(op)) {
    auto loop = op->getParentOfType<ParallelForOp>();
    if (loop && loop.getSerialize()) {
      emitError(op, "a random number drawn here is needed by the gradient, "
                    "whose iterations run in another order")
              .attachNote()
          << "draw it in a serial loop inside of a parallel one, or store it "
             "to "
             "a field in a kernel of its own";
      return false;
    }
    // Else it is drawn in the order of the kernel, and recorded.
    if (isInSerialLoop(op) || !recomputedDraws.insert(op).second) {
      larger.recorded.insert(op);
      wantsMore = true;
    }
    return true;
  }
  if (auto access = dyn_cast<DifferentiableAccessInterface>(op)) {
    if (access.getAccessKind() != AccessKind::Read) {
      emitError(op, "the value before the update is needed by the gradient, "
                    "but is gone when the gradient runs")
              .attachNote()
          << "store it to a field that nothing else writes, and load it from "
             "there in a later kernel: slot[i] = atomic_add(n, 1), and then "
             "y[slot[i]]";
      return false;
    }
    return checkReadable(access);
  }
  if (isMemoryEffectFree(op) || hasSingleEffect<MemoryEffects::Read>(op))
    return true;
  emitError(op, "the result of '" + op->getName().getStringRef() +
                    "' is needed by the gradient and cannot be computed again");
  return false;
}

bool AdjointBuilder::checkReadable(DifferentiableAccessInterface read) {
  needed.insert(read);
  if (accumulated.contains(read.getAccessedStorage().getOpaque())) {
    emitError(read, "the value read here is needed by the gradient, but is an "
                    "adjoint that the gradient itself accumulates")
            .attachNote()
        << "copy the adjoint to a field of its own first";
    return false;
  }
  return true;
}
