//===- ForwardReexecution.cpp - Re-executing the primal -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "ForwardReexecution.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

/// Name of an attribute of re-executed reads, while the adjoint is being
/// emitted: the index, in ForwardReexecution::reads, of the primal read that is
/// repeated.
constexpr llvm::StringLiteral kRepeatedReadAttrName = "tai.rerun_read";

//===----------------------------------------------------------------------===//
// Repeated execution
//===----------------------------------------------------------------------===//

namespace {
/// Finds the ops of a primal block that have to be executed again, and copies
/// them into the mirror of the block.
class Slice {
public:
  Slice(AdjointBuilder &builder, ReexecutedBlock &again,
        SmallVectorImpl<Operation *> &reads)
      : b(builder), again(again), reads(reads), unit(again.frame.primal) {}

  /// Finds the accesses and random draws for which `matters` holds, and all ops
  /// that they depend on.
  void find(llvm::function_ref<bool(Operation *)> matters);
  void copy() { copyBlock(unit, again.frame.mirror); }

  /// `counts`: true for loops whose iterations must be counted. `writes`: true
  /// for writes to fields that the second execution repeats.
  llvm::function_ref<bool(Operation *)> counts, writes;

private:
  void markLive(Operation *op);
  void copyBlock(Block *from, Block *to);
  Operation *copyOp(Operation *op);
  Operation *copyWhile(scf::WhileOp loop);
  void checkCopy(Operation *op, Operation *copy);
  Value lookup(Value value);

  AdjointBuilder &b;
  ReexecutedBlock &again;
  SmallVectorImpl<Operation *> &reads;
  Block *unit;
  DenseSet<Operation *> live;
  SmallVector<Operation *> pending;
};
} // namespace

void Slice::markLive(Operation *op) {
  if (live.insert(op).second)
    pending.push_back(op);
}

void Slice::find(llvm::function_ref<bool(Operation *)> matters) {
  Operation *root = unit->getParentOp();
  auto markValue = [&](Value value) {
    Operation *owner = value.getDefiningOp();
    if (owner && root->isProperAncestor(owner))
      markLive(owner);
  };
  for (Operation &op : *unit)
    op.walk([&](Operation *inner) {
      if (matters(inner))
        markLive(inner);
    });
  while (!pending.empty()) {
    Operation *op = pending.pop_back_val();
    llvm::for_each(op->getOperands(), markValue);
    if (op->getParentOp() != root)
      markLive(op->getParentOp());
    for (Region &region : op->getRegions())
      for (Block &block : region)
        markLive(block.getTerminator());
    // If an array is allocated within the block, all accesses to it are
    // repeated.
    if (auto access = dyn_cast<DifferentiableAccessInterface>(op))
      if (Value array = access.getAccessedStorage().memref)
        if (Operation *owner = array.getDefiningOp();
            owner && root->isProperAncestor(owner))
          for (Operation *user : array.getUsers())
            markLive(user);
  }
}

/// The value, in the second execution, of a primal value. A value from outside
/// of the re-executed block is rematerialised before the block.
Value Slice::lookup(Value value) {
  if (Value known = again.values.lookupOrNull(value))
    return known;
  Value outer = b.getPrimal(value);
  again.values.map(value, outer);
  return outer;
}

Operation *Slice::copyWhile(scf::WhileOp loop) {
  SmallVector<Value> inits;
  for (Value init : loop.getInits())
    inits.push_back(lookup(init));
  inits.push_back(arith::ConstantIndexOp::create(b, 0));
  SmallVector<Type> types(loop.getResultTypes());
  types.push_back(b.getIndexType());
  auto copy = scf::WhileOp::create(b, types, inits);
  OpBuilder::InsertionGuard guard(b);
  for (auto [from, to] : llvm::zip(loop->getRegions(), copy->getRegions())) {
    Block *body = b.createBlock(&to);
    for (BlockArgument argument : from.getArguments())
      again.values.map(
          argument, body->addArgument(argument.getType(), argument.getLoc()));
    Value count = body->addArgument(b.getIndexType(), b.getLoc());
    copyBlock(&from.front(), body);
    Operation *terminator = body->getTerminator();
    if (isa<scf::YieldOp>(terminator)) {
      b.setInsertionPoint(terminator);
      count =
          arith::AddIOp::create(b, count, arith::ConstantIndexOp::create(b, 1));
    }
    terminator->insertOperands(terminator->getNumOperands(), count);
  }
  again.counts[loop] = copy.getResults().back();
  return copy;
}

Operation *Slice::copyOp(Operation *op) {
  IRMapping operands;
  for (Value operand : op->getOperands())
    operands.map(operand, lookup(operand));
  Operation *copy = b.insert(op->cloneWithoutRegions(operands));
  OpBuilder::InsertionGuard guard(b);
  for (auto [from, to] : llvm::zip(op->getRegions(), copy->getRegions())) {
    if (from.empty())
      continue;
    Block *body = b.createBlock(&to);
    for (BlockArgument argument : from.getArguments())
      again.values.map(
          argument, body->addArgument(argument.getType(), argument.getLoc()));
    copyBlock(&from.front(), body);
  }
  return copy;
}

void Slice::copyBlock(Block *from, Block *to) {
  if (from != unit)
    b.setInsertionPointToEnd(to);
  for (Operation &op : *from) {
    if (!live.contains(&op))
      continue;
    b.setLoc(op.getLoc());
    auto loop = dyn_cast<scf::WhileOp>(op);
    Operation *copy = loop && counts(loop) ? copyWhile(loop) : copyOp(&op);
    for (auto [before, after] : llvm::zip(op.getResults(), copy->getResults()))
      again.values.map(before, after);
    checkCopy(&op, copy);
  }
}

/// Notes the reads of a copied op, and refuses an op that must not run
/// twice.
void Slice::checkCopy(Operation *op, Operation *copy) {
  if (auto access = dyn_cast<DifferentiableAccessInterface>(op)) {
    Value array = access.getAccessedStorage().memref;
    bool isOwn = array && unit->getParentOp()->isAncestor(
                              array.getParentBlock()->getParentOp());
    if (access.getAccessKind() == AccessKind::Read) {
      copy->setAttr(kRepeatedReadAttrName, b.getIndexAttr(reads.size()));
      reads.push_back(op);
    } else if (!isOwn && !writes(op)) {
      b.emitError(op, "the value before the update is needed by the gradient, "
                      "but is gone when the gradient runs")
              .attachNote()
          << "store it to a field that nothing else writes, and load it from "
             "there";
    }
    return;
  }
  if (op->getNumRegions() == 0 && !isa<RandomOp>(op) &&
      !isMemoryEffectFree(op) && !hasSingleEffect<MemoryEffects::Read>(op) &&
      !hasSingleEffect<MemoryEffects::Allocate>(op) &&
      !hasSingleEffect<MemoryEffects::Free>(op))
    b.emitError(op, "the result of '" + op->getName().getStringRef() +
                        "' is needed by the gradient and cannot be computed "
                        "again");
}

//===----------------------------------------------------------------------===//
// Recording
//===----------------------------------------------------------------------===//

void ForwardReexecution::begin(Frame &frame) {
  OpBuilder::InsertionGuard guard(b);
  Location loc = b.getLoc();
  innermost = std::make_unique<ReexecutedBlock>(frame, std::move(innermost));
  for (BlockArgument argument : frame.primal->getArguments())
    if (Value known = frame.values.lookupOrNull(argument))
      innermost->values.map(argument, known);
  b.setInsertionPoint(frame.recomputeBegin);
  innermost->begin = b.createConstant(b.getF32Type(), 0).getDefiningOp();
  Slice slice(b, *innermost, reads);
  auto isCounted = [&](Operation *op) { return plan.holdsRecorded(op); };
  auto isWritten = [&](Operation *op) {
    auto access = dyn_cast<DifferentiableAccessInterface>(op);
    return access && access.getAccessKind() != AccessKind::Read &&
           plan.isRewritten(getStorageKey(op));
  };
  slice.counts = isCounted;
  slice.writes = isWritten;
  slice.find([&](Operation *op) {
    return getReexecutedBlock(op) == frame.primal &&
           (plan.isRecorded(op) || isWritten(op));
  });
  b.setInsertionPoint(frame.recomputeBegin);
  slice.copy();
  b.setLoc(loc);
}

Value ForwardReexecution::fetch(Frame &frame, Value value) {
  ReexecutedBlock *from = innermost.get();
  while (from && !from->values.contains(value))
    from = from->parent.get();
  if (!from) {
    b.emitError(value.getDefiningOp() ? value.getDefiningOp()
                                      : frame.primal->getParentOp(),
                "a value that the gradient needs cannot be recorded");
    return value;
  }
  Value known = from->values.lookup(value);
  if (&frame == &from->frame)
    return known;
  if (!frame.recomputeBegin) {
    b.emitError(
        frame.primal->getParentOp(),
        "the gradient needs a value that this op carries, which cannot be "
        "recomputed");
    return value;
  }
  OpBuilder::InsertionGuard guard(b);
  auto vector = dyn_cast<VectorType>(known.getType());
  Type scalar = getElementTypeOrSelf(known.getType());
  int64_t count = vector ? vector.getNumElements() : 1;
  ReexecutedBlock::Record &record = from->records[known];
  if (record.stacks.empty()) {
    record.block = frame.primal;
    b.setInsertionPoint(from->begin);
    for (int64_t i = 0; i != count; ++i)
      record.stacks.push_back(StackCreateOp::create(b, StackType::get(scalar)));
    b.setInsertionPointAfterValue(known);
    for (auto [i, stack] : llvm::enumerate(record.stacks))
      StackPushOp::create(b, vector ? b.createExtract(known, i) : known, stack);
  }
  b.setInsertionPoint(frame.recomputeBegin);
  SmallVector<Value> components;
  for (Value stack : record.stacks)
    components.push_back(StackPopOp::create(b, scalar, stack));
  frame.popped.insert(known);
  return vector ? b.createVector(vector, components) : components.front();
}

Value ForwardReexecution::fetchCount(scf::WhileOp loop) {
  ReexecutedBlock *from = innermost.get();
  while (from && !from->counts.count(loop))
    from = from->parent.get();
  if (!from)
    return arith::ConstantIndexOp::create(b, 0); // after an error
  Value count = from->counts.lookup(loop);
  from->values.map(count, count);
  return fetch(b.getFrame(), count);
}

void ForwardReexecution::leave(Frame &frame) {
  ReexecutedBlock *from = innermost.get();
  if (from && &frame == &from->frame) {
    // Take the parent out of `from` first: assigning to `innermost` frees
    // `from`.
    std::unique_ptr<ReexecutedBlock> outer = std::move(from->parent);
    innermost = std::move(outer);
    frame.recomputeBegin->erase();
    return;
  }
  if (from)
    from->mirrors.push_back(
        {frame.primal, frame.recomputeBegin, std::move(frame.popped)});
  else
    frame.recomputeBegin->erase();
}

void ForwardReexecution::end(Frame &frame) {
  OpBuilder::InsertionGuard guard(b);
  for (auto &[value, record] : innermost->records) {
    for (ReexecutedBlock::Mirror &mirror : innermost->mirrors)
      if (mirror.block == record.block && !mirror.popped.contains(value)) {
        b.setInsertionPoint(mirror.marker);
        for (Value stack : record.stacks)
          StackPopOp::create(
              b, cast<StackType>(stack.getType()).getElementType(), stack);
      }
    b.setInsertionPointToEnd(frame.mirror);
    for (Value stack : record.stacks)
      StackDestroyOp::create(b, stack);
  }
  for (ReexecutedBlock::Mirror &mirror : innermost->mirrors)
    mirror.marker->erase();
  innermost->begin->erase();
}

static void eraseDead(Region &region) {
  for (Block &block : region)
    for (Operation &op : llvm::make_early_inc_range(llvm::reverse(block))) {
      for (Region &nested : op.getRegions())
        eraseDead(nested);
      if (isOpTriviallyDead(&op))
        op.erase();
    }
}

void ForwardReexecution::collectReads(FunctionOpInterface adjoint,
                                      PrimalDemands &demands) {
  if (!plan.hasRecorded())
    return;
  dropDeadCarried(adjoint.getFunctionBody());
  eraseDead(adjoint.getFunctionBody());
  adjoint.getFunctionBody().walk([&](Operation *op) {
    auto index =
        dyn_cast_if_present<IntegerAttr>(op->removeAttr(kRepeatedReadAttrName));
    if (index)
      demands.reads.insert(reads[index.getInt()]);
  });
}
