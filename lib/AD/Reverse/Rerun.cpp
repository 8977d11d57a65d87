//===- Rerun.cpp - Running the primal forward again -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Where neither what a field held before a launch nor what it holds afterwards
// is all that the reverse needs, the block is run forward again on what was
// there before, with its stores to such fields. So are random draws in serial
// loops, which must come in the same order. What the reverse asks for is pushed
// on a stack, one for each value, when the rerun computes it; the reverse pops
// it where the mirror of the same block begins. Each execution of a block
// pushes once and each reversed execution pops once, so that the orders agree
// however loops and branches are nested.
//
// All else is recomputed from what is popped, as it is elsewhere.
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Rerun.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

/// On a read of a rerun, while the adjoint is built: which read it repeats.
constexpr llvm::StringLiteral kRerunReadAttrName = "tai.rerun_read";

Block *mlir::tai::getRerunUnit(Operation *op) {
  Operation *up = op;
  while (!isa<FunctionOpInterface>(up->getParentOp())) {
    up = up->getParentOp();
    if (isa<ParallelForOp, scf::ParallelOp>(up) && !isSerialLoop(up))
      return &up->getRegion(0).front();
  }
  return up->getBlock();
}

//===----------------------------------------------------------------------===//
// What is run again
//===----------------------------------------------------------------------===//

namespace {
/// Copies the ops of a block that matter, into the mirror.
class Slice {
public:
  Slice(AdjointBuilder &builder, Rerun &rerun,
        SmallVectorImpl<Operation *> &reads)
      : b(builder), rerun(rerun), reads(reads), unit(rerun.frame.primal) {}

  /// `matters` says which accesses and draws do by themselves.
  void find(llvm::function_ref<bool(Operation *)> matters);
  void copy() { copyBlock(unit, rerun.frame.mirror); }

  /// Loops whose iterations are to be counted, and writes that are repeated.
  llvm::function_ref<bool(Operation *)> counts, writes;

private:
  void markLive(Operation *op);
  void copyBlock(Block *from, Block *to);
  Operation *copyOp(Operation *op);
  Operation *copyWhile(scf::WhileOp loop);
  void checkCopy(Operation *op, Operation *copy);
  Value lookup(Value value);

  AdjointBuilder &b;
  Rerun &rerun;
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
    // Stores to an array that lives here belong to it.
    if (auto access = dyn_cast<DifferentiableAccessInterface>(op))
      if (Value array = access.getAccessedStorage().memref)
        if (Operation *owner = array.getDefiningOp();
            owner && root->isProperAncestor(owner))
          for (Operation *user : array.getUsers())
            markLive(user);
  }
}

/// The value in the rerun; one from outside is recomputed there.
Value Slice::lookup(Value value) {
  if (Value known = rerun.values.lookupOrNull(value))
    return known;
  Value outer = b.getPrimal(value);
  rerun.values.map(value, outer);
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
      rerun.values.map(
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
  rerun.counts[loop] = copy.getResults().back();
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
      rerun.values.map(
          argument, body->addArgument(argument.getType(), argument.getLoc()));
    copyBlock(&from.front(), body);
  }
  return copy;
}

void Slice::copyBlock(Block *from, Block *to) {
  bool isUnit = from == unit;
  if (!isUnit)
    b.setInsertionPointToEnd(to);
  for (Operation &op : *from) {
    if (!live.contains(&op) || (isUnit && &op == from->getTerminator()))
      continue;
    b.setLoc(op.getLoc());
    auto loop = dyn_cast<scf::WhileOp>(op);
    Operation *copy = loop && counts(loop) ? copyWhile(loop) : copyOp(&op);
    for (auto [before, after] : llvm::zip(op.getResults(), copy->getResults()))
      rerun.values.map(before, after);
    checkCopy(&op, copy);
  }
}

/// Notes what a copied op reads, and refuses one that does what must not be
/// done again.
void Slice::checkCopy(Operation *op, Operation *copy) {
  if (auto access = dyn_cast<DifferentiableAccessInterface>(op)) {
    Value array = access.getAccessedStorage().memref;
    bool isOwn = array && unit->getParentOp()->isProperAncestor(
                              array.getParentBlock()->getParentOp());
    if (access.getAccessKind() == AccessKind::Read) {
      copy->setAttr(kRerunReadAttrName, b.getIndexAttr(reads.size()));
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
      !hasSingleEffect<MemoryEffects::Allocate>(op))
    b.emitError(op, "the result of '" + op->getName().getStringRef() +
                        "' is needed by the gradient and cannot be computed "
                        "again");
}

//===----------------------------------------------------------------------===//
// Recording
//===----------------------------------------------------------------------===//

/// True if the value is taken from the rerun and not recomputed.
bool AdjointBuilder::isRecorded(Value value) const {
  if (plan.recorded.empty())
    return false;
  if (Operation *owner = value.getDefiningOp())
    return plan.recorded.contains(owner) || holders.contains(owner);
  auto argument = cast<BlockArgument>(value);
  Operation *loop = argument.getOwner()->getParentOp();
  if (!holders.contains(loop))
    return false;
  auto forOp = dyn_cast<scf::ForOp>(loop);
  return forOp ? argument != forOp.getInductionVar() : isa<scf::WhileOp>(loop);
}

void AdjointBuilder::beginRerun(Frame &frame) {
  OpBuilder::InsertionGuard guard(*this);
  Location loc = getLoc();
  rerun = std::make_unique<Rerun>(frame, std::move(rerun));
  for (BlockArgument argument : frame.primal->getArguments())
    if (Value known = frame.values.lookupOrNull(argument))
      rerun->values.map(argument, known);
  setInsertionPoint(frame.recomputeBegin);
  rerun->begin = createConstant(getF32Type(), 0).getDefiningOp();
  Slice slice(*this, *rerun, rerunReads);
  auto isCounted = [&](Operation *op) { return holders.contains(op); };
  auto isWritten = [&](Operation *op) {
    auto access = dyn_cast<DifferentiableAccessInterface>(op);
    return access && access.getAccessKind() != AccessKind::Read &&
           plan.storages.contains(getStorageKey(op));
  };
  slice.counts = isCounted;
  slice.writes = isWritten;
  slice.find([&](Operation *op) {
    return getRerunUnit(op) == frame.primal &&
           (plan.recorded.contains(op) || isWritten(op));
  });
  setInsertionPoint(frame.recomputeBegin);
  slice.copy();
  setLoc(loc);
}

/// The value of the rerun that stands for a primal one, where it is asked for.
Value AdjointBuilder::fetchRecorded(Frame &frame, Value value) {
  Rerun *from = rerun.get();
  while (from && !from->values.contains(value))
    from = from->parent.get();
  if (!from) {
    emitError(value.getDefiningOp() ? value.getDefiningOp()
                                    : frame.primal->getParentOp(),
              "a value that the gradient needs cannot be recorded");
    return value;
  }
  Value known = from->values.lookup(value);
  if (&frame == &from->frame)
    return known;
  if (!frame.recomputeBegin) {
    emitError(
        frame.primal->getParentOp(),
        "the gradient needs a value that this op carries, which cannot be "
        "recomputed");
    return value;
  }
  OpBuilder::InsertionGuard guard(*this);
  auto vector = dyn_cast<VectorType>(known.getType());
  Type scalar = getElementTypeOrSelf(known.getType());
  int64_t count = vector ? vector.getNumElements() : 1;
  Rerun::Record &record = from->records[known];
  if (record.stacks.empty()) {
    record.block = frame.primal;
    setInsertionPoint(from->begin);
    for (int64_t i = 0; i != count; ++i)
      record.stacks.push_back(
          StackCreateOp::create(*this, StackType::get(scalar)));
    setInsertionPointAfterValue(known);
    for (auto [i, stack] : llvm::enumerate(record.stacks))
      StackPushOp::create(*this, vector ? createExtract(known, i) : known,
                          stack);
  }
  setInsertionPoint(frame.recomputeBegin);
  SmallVector<Value> components;
  for (Value stack : record.stacks)
    components.push_back(StackPopOp::create(*this, scalar, stack));
  frame.popped.insert(known);
  return vector ? createVector(vector, components) : components.front();
}

Value AdjointBuilder::fetchCount(scf::WhileOp loop) {
  Rerun *from = rerun.get();
  while (from && !from->counts.count(loop))
    from = from->parent.get();
  if (!from)
    return arith::ConstantIndexOp::create(*this, 0); // after an error
  Value count = from->counts.lookup(loop);
  from->values.map(count, count);
  return fetchRecorded(*current, count);
}

/// Where a mirror ends: other mirrors of the block may still ask for values
/// that this one must then pop as well.
void AdjointBuilder::leaveMirror(Frame &frame) {
  Rerun *from = rerun.get();
  if (from && &frame == &from->frame) {
    // Out of the way before what hangs on it goes.
    std::unique_ptr<Rerun> outer = std::move(from->parent);
    rerun = std::move(outer);
    frame.recomputeBegin->erase();
    return;
  }
  if (from)
    from->mirrors.push_back(
        {frame.primal, frame.recomputeBegin, std::move(frame.popped)});
  else
    frame.recomputeBegin->erase();
}

void AdjointBuilder::endRerun(Frame &frame) {
  OpBuilder::InsertionGuard guard(*this);
  for (auto &[value, record] : rerun->records) {
    for (Rerun::Mirror &mirror : rerun->mirrors)
      if (mirror.block == record.block && !mirror.popped.contains(value)) {
        setInsertionPoint(mirror.marker);
        for (Value stack : record.stacks)
          StackPopOp::create(
              *this, cast<StackType>(stack.getType()).getElementType(), stack);
      }
    setInsertionPointToEnd(frame.mirror);
    for (Value stack : record.stacks)
      StackDestroyOp::create(*this, stack);
  }
  for (Rerun::Mirror &mirror : rerun->mirrors)
    mirror.marker->erase();
  rerun->begin->erase();
}

/// Erases the ops whose results nothing uses.
static void eraseDead(Region &region) {
  for (Block &block : region)
    for (Operation &op : llvm::make_early_inc_range(llvm::reverse(block))) {
      for (Region &nested : op.getRegions())
        eraseDead(nested);
      if (isOpTriviallyDead(&op))
        op.erase();
    }
}

/// The reads of reruns that something needs count as those of the adjoint.
void AdjointBuilder::collectRerunReads() {
  if (plan.recorded.empty())
    return;
  dropDeadCarried(adjoint.getFunctionBody());
  eraseDead(adjoint.getFunctionBody());
  adjoint.getFunctionBody().walk([&](Operation *op) {
    auto index =
        dyn_cast_if_present<IntegerAttr>(op->removeAttr(kRerunReadAttrName));
    if (index)
      needed.insert(rerunReads[index.getInt()]);
  });
}
