//===- Rematerializer.cpp - Primal values in an adjoint -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Rematerializer.h"
#include "ForwardReexecution.h"
#include "StoredOutputs.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "tai/AD/Reverse/LoopHistory.h"
#include "tai/Analysis/Owners.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

Value Rematerializer::loadStored(Frame &frame, Value value) {
  return stored && isForRule && frame.sweepBegin ? stored->load(b, frame, value)
                                                 : Value();
}

Value Rematerializer::get(Value value) {
  value = plan.local.resolve(value);
  Block *block = value.getParentBlock();
  Frame *frame = &b.getFrame();
  while (frame && frame->primal != block)
    frame = frame->parent;
  assert(frame && "a primal value is asked for outside of its block");
  if (Value known = frame->values.lookupOrNull(value))
    return known;
  return materialize(*frame, value);
}

/// True for a read of an array that the function allocates: the array no longer
/// exists when the adjoint runs.
bool Rematerializer::isOwnRead(Operation *op) const {
  auto read = dyn_cast<DifferentiableAccessInterface>(op);
  Value array = read ? read.getAccessedStorage().memref : Value();
  return plan.local.toRecord && array && plan.isOwnArray(array) &&
         !holdsOwners(array);
}

/// Appends to `missing` the ops of the frame's block that `op` needs and that
/// are not recomputed yet. Returns true if there are any.
bool Rematerializer::needsOperands(Frame &frame, Operation *op,
                                   SmallVectorImpl<Operation *> &missing) {
  size_t before = missing.size();
  if (isOwnRead(op))
    return false;
  for (Value given : op->getOperands())
    if (Value operand = plan.local.resolve(given);
        operand.getParentBlock() == frame.primal && operand.getDefiningOp() &&
        !frame.values.contains(operand)) {
      if (plan.reexecution.isRecorded(operand))
        frame.values.map(operand, reexecution.fetch(frame, operand));
      else if (Value kept = loadStored(frame, operand))
        frame.values.map(operand, kept);
      else
        missing.push_back(operand.getDefiningOp());
    }
  return missing.size() != before;
}

Value Rematerializer::materialize(Frame &frame, Value value) {
  OpBuilder::InsertionGuard guard(b);
  Location loc = b.getLoc();
  auto scope = b.enter(frame);
  if (auto argument = dyn_cast<BlockArgument>(value)) {
    materializeArgument(frame, argument);
  } else if (plan.reexecution.isRecorded(value)) {
    frame.values.map(value, reexecution.fetch(frame, value));
  } else if (Value kept = loadStored(frame, value)) {
    frame.values.map(value, kept);
  } else {
    // The search uses a worklist instead of recursion, because chains of
    // operands can be long.
    SmallVector<Operation *> pending = {value.getDefiningOp()};
    while (!pending.empty()) {
      Operation *op = pending.back();
      if (frame.recomputed.count(op)) {
        pending.pop_back();
      } else if (refused.contains(op)) {
        // Recomputation of `op` was refused in another frame of the same block,
        // so its results are not mapped in this frame yet.
        frame.values.map(op->getResults(), op->getResults());
        pending.pop_back();
      } else if (!needsOperands(frame, op, pending)) {
        pending.pop_back();
        recompute(frame, op);
      }
    }
  }
  b.setLoc(loc);
  // After an error, the primal value stands in: the adjoint will be discarded.
  if (!frame.values.contains(value))
    frame.values.map(value, value);
  return frame.values.lookup(value);
}

void Rematerializer::materializeArgument(Frame &frame, BlockArgument argument) {
  Operation *parent = frame.primal->getParentOp();
  unsigned index = argument.getArgNumber();
  auto scope = b.enter(*frame.parent);
  Value value;
  if (!frame.argumentValues.empty()) {
    value = get(frame.argumentValues[index]);
  } else if (plan.reexecution.isRecorded(argument)) {
    value = reexecution.fetch(frame, argument);
  } else if (frame.history) {
    if (auto loop = dyn_cast<scf::ForOp>(parent))
      index -= loop.getNumInductionVars();
    value = frame.history->getCarried(frame, index);
  } else {
    b.emitError(parent,
                "the gradient needs a value that this op carries, which "
                "cannot be recomputed");
  }
  if (value)
    frame.values.map(argument, value);
}

/// Recomputed ops are inserted in the order of the primal ops.
void Rematerializer::setInsertionPointFor(Frame &frame, Operation *op) {
  auto next = frame.recomputed.lower_bound(op);
  if (next != frame.recomputed.end())
    b.setInsertionPoint(next->second);
  else if (frame.sweepBegin)
    b.setInsertionPoint(frame.sweepBegin);
  else
    b.setInsertionPointToEnd(frame.mirror);
  b.setLoc(op->getLoc());
}

/// Computes the owners of elements again: see tai-choose-writers. A loop that
/// computes the owners for several fields is copied for each field.
void Rematerializer::recomputeOwners(Frame &frame, memref::AllocOp alloc) {
  SmallVector<Operation *> setters = findOwnerSetters(alloc);
  llvm::SetVector<Value> captured(llvm::from_range, alloc->getOperands());
  bool isReadable = true;
  DenseSet<Value> otherOwners;
  for (Operation *setter : setters) {
    auto isFromOutside = [&](Value value) {
      return !setter->isAncestor(value.getParentBlock()->getParentOp()) &&
             !holdsOwners(value);
    };
    setter->walk([&](Operation *op) {
      for (Value operand : op->getOperands())
        if (isFromOutside(operand))
          captured.insert(operand);
      auto read = dyn_cast<DifferentiableAccessInterface>(op);
      Value memref = read ? read.getAccessedStorage().memref : Value();
      if (memref && memref != alloc.getResult() && holdsOwners(memref))
        otherOwners.insert(memref);
      if (!read || read.getAccessKind() != AccessKind::Read)
        return;
      isReadable &= checkReadable(read);
      if (!b.isReexecuted(read))
        return;
      isReadable = false;
      b.emitError(read, "the value read here decides which iteration stores to "
                        "an element, and is overwritten")
              .attachNote()
          << "put the stores into a kernel of their own";
    });
  }
  if (!isReadable) {
    frame.values.map(alloc.getResult(), alloc.getResult());
    refused.insert(alloc);
    return;
  }
  IRMapping mapping;
  for (Value value : captured)
    mapping.map(value, get(value));
  // The operands of the setters (the ops that write the buffer) can be computed
  // between them, so new ops are inserted at the last setter.
  Operation *last = setters.empty() ? alloc : setters.back();
  setInsertionPointFor(frame, last);
  Operation *copy = b.clone(*alloc, mapping);
  Value owners = copy->getResult(0);
  frame.values.map(alloc.getResult(), owners);
  frame.recomputed.try_emplace(last, copy);
  frame.buffers.push_back(owners);
  for (Operation *setter : setters)
    b.clone(*setter, mapping)->walk([&](Operation *op) {
      auto access = dyn_cast<DifferentiableAccessInterface>(op);
      if (access && otherOwners.contains(access.getAccessedStorage().memref))
        op->erase();
    });
}

void Rematerializer::recompute(Frame &frame, Operation *op) {
  if (auto alloc = dyn_cast<memref::AllocOp>(op); alloc && holdsOwners(alloc))
    return recomputeOwners(frame, alloc);
  if (isOwnRead(op)) {
    // The adjoint will be emitted again, with a recorded value for this read.
    demands.reads.insert(op);
    frame.values.map(op->getResults(), op->getResults());
    refused.insert(op);
    return;
  }
  if (!checkRecomputable(op)) {
    frame.values.map(op->getResults(), op->getResults());
    refused.insert(op);
    return;
  }
  // Operands that are defined in an outer block are recomputed in the frame of
  // that block.
  IRMapping mapping;
  for (Value operand : op->getOperands())
    mapping.map(operand, get(operand));
  setInsertionPointFor(frame, op);
  Operation *copy = b.insert(op->cloneWithoutRegions(mapping));
  for (auto [from, to] : llvm::zip(op->getResults(), copy->getResults()))
    frame.values.map(from, to);
  // Values that the op's regions capture have to be recomputed before the op,
  // where the adjoint can use them.
  frame.recomputed[op] = copy;
  if (op->getNumRegions() != 0)
    recomputeRegions(op, copy);
}

void Rematerializer::recomputeRegions(Operation *op, Operation *copy) {
  OpBuilder::InsertionGuard guard(b);
  for (auto [from, to] : llvm::zip(op->getRegions(), copy->getRegions())) {
    if (from.empty())
      continue;
    Block *mirror = b.createBlock(&to);
    for (BlockArgument argument : from.front().getArguments())
      mirror->addArgument(argument.getType(), argument.getLoc());
    cloneBlock(&from.front(), mirror);
  }
}

void Rematerializer::cloneBlock(Block *primal, Block *mirror) {
  Frame frame(&b.getFrame(), primal, mirror);
  for (auto [from, to] :
       llvm::zip(primal->getArguments(), mirror->getArguments()))
    frame.values.map(from, to);
  auto scope = b.enter(frame);
  Operation *terminator = primal->getTerminator();
  IRMapping mapping;
  for (Value operand : terminator->getOperands())
    mapping.map(operand, get(operand));
  b.setInsertionPointToEnd(mirror);
  for (Value buffer : frame.buffers)
    memref::DeallocOp::create(b, buffer);
  b.clone(*terminator, mapping);
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

bool Rematerializer::checkRecomputable(Operation *op) {
  if (op->getNumRegions() != 0) {
    if (llvm::all_of(op->getRegions(), [](Region &region) {
          return region.empty() || region.hasOneBlock();
        }))
      return true;
    b.emitError(op, "'" + op->getName().getStringRef() +
                        "' has several blocks and is needed by the gradient; "
                        "structured control flow is expected");
    return false;
  }
  if (isa<RandomOp>(op)) {
    auto loop = op->getParentOfType<ParallelForOp>();
    if (loop && loop.getSerialize()) {
      b.emitError(op, "a random number drawn here is needed by the gradient, "
                      "whose iterations run in another order")
              .attachNote()
          << "draw it in a serial loop inside of a parallel one, or store it "
             "to "
             "a field in a kernel of its own";
      return false;
    }
    // A number that cannot be drawn in the order of the adjoint is drawn by a
    // second execution in the order of the kernel, and recorded.
    if (isInSerialLoop(op) || !recomputedDraws.insert(op).second) {
      demands.draws.insert(op);
    }
    return true;
  }
  if (auto access = dyn_cast<DifferentiableAccessInterface>(op)) {
    if (access.getAccessKind() != AccessKind::Read) {
      b.emitError(op, "the value before the update is needed by the gradient, "
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
  b.emitError(op,
              "the result of '" + op->getName().getStringRef() +
                  "' is needed by the gradient and cannot be computed again");
  return false;
}

bool Rematerializer::checkReadable(DifferentiableAccessInterface read) {
  // A read of a buffer of owners needs no record, because owners are computed
  // again.
  if (Value memref = read.getAccessedStorage().memref;
      memref && holdsOwners(memref))
    return true;
  demands.reads.insert(read);
  if (plan.accumulated.contains(read.getAccessedStorage().getOpaque())) {
    b.emitError(read,
                "the value read here is needed by the gradient, but is an "
                "adjoint that the gradient itself accumulates")
            .attachNote()
        << "copy the adjoint to a field of its own first";
    return false;
  }
  return true;
}
