//===- GuardVersions.cpp - Code with and without guards -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "GuardVersions.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "tai/Analysis/ZeroTests.h"

using namespace mlir;
using namespace mlir::tai;

/// Moves the ops before `branch` that only ops of `to` use to the start of
/// `to`.
static void sinkInto(Block *to, Operation *branch) {
  for (Operation *op = branch->getPrevNode(); op;) {
    Operation *candidate = std::exchange(op, op->getPrevNode());
    if (isMovable(candidate) && !candidate->use_empty() &&
        llvm::all_of(candidate->getUsers(), [&](Operation *user) {
          return to->findAncestorOpInBlock(*user);
        }))
      candidate->moveBefore(to, to->begin());
  }
}

scf::IfOp tai::createVersions(Operation *begin, Value condition,
                              IRMapping &bare, ArrayRef<Operation *> own) {
  Block &block = *begin->getBlock();
  // Both branches get all of the rest of the block. Otherwise the results of
  // the rest would be live until the test is made.
  Operation *terminator = block.getTerminator();
  SetVector<Operation *> moved(own.begin(), own.end());
  SmallVector<Operation *> tail;
  for (Operation *op = begin; op != terminator; op = op->getNextNode()) {
    tail.push_back(op);
    moved.insert(op);
  }
  SmallVector<OpOperand *> yielded;
  SmallVector<Type> types;
  SmallVector<Value> guardedResults, bareResults;
  for (OpOperand &operand : terminator->getOpOperands())
    if (Operation *op = operand.get().getDefiningOp();
        op && moved.contains(op)) {
      yielded.push_back(&operand);
      types.push_back(operand.get().getType());
      guardedResults.push_back(operand.get());
    }
  OpBuilder builder(begin);
  Location loc = condition.getLoc();
  auto branch = scf::IfOp::create(builder, loc, types, condition,
                                  /*withElseRegion=*/true);
  branch->setAttr(kGuardVersions, builder.getUnitAttr());
  Block *fast = branch.thenBlock(), *guarded = branch.elseBlock();
  if (types.empty()) {
    fast->getTerminator()->erase();
    guarded->getTerminator()->erase();
  }
  builder.setInsertionPointToStart(fast);
  for (Operation *op : tail)
    builder.clone(*op, bare);
  for (Value result : guardedResults)
    bareResults.push_back(bare.lookup(result));
  scf::YieldOp::create(builder, loc, bareResults);
  builder.setInsertionPointToStart(guarded);
  auto yield = scf::YieldOp::create(builder, loc, guardedResults);
  for (auto [operand, result] : llvm::zip(yielded, branch.getResults()))
    operand->set(result);
  for (Operation *op : own)
    op->moveBefore(yield);
  for (Operation *op : tail)
    op->moveBefore(yield);
  // Ops that only one of the two versions uses move into it.
  sinkInto(guarded, branch);
  sinkInto(fast, branch);
  return branch;
}

Value tai::markLikely(OpBuilder &builder, Value condition) {
  Location loc = condition.getLoc();
  Value likely = arith::ConstantIntOp::create(builder, loc, /*value=*/1, 1);
  return LLVM::ExpectOp::create(builder, loc, condition, likely);
}

//===----------------------------------------------------------------------===//
// Tests before the guards
//===----------------------------------------------------------------------===//

/// True if only the conditions of guards use the op.
static bool isForConditions(Operation *op, DenseMap<Operation *, bool> &known) {
  if (op->use_empty() || !isMovable(op))
    return false;
  auto [it, isNew] = known.try_emplace(op, false);
  if (!isNew)
    return it->second;
  bool result = llvm::all_of(op->getUses(), [&](OpOperand &use) {
    return (isGuard(use.getOwner()) && use.getOperandNumber() == 0) ||
           isForConditions(use.getOwner(), known);
  });
  return known[op] = result;
}

bool tai::hasGuardsInside(Operation &op) {
  return op.getNumRegions() != 0 && op.walk([](Operation *inner) {
                                        return isGuard(inner)
                                                   ? WalkResult::interrupt()
                                                   : WalkResult::advance();
                                      }).wasInterrupted();
}

/// Finds the guards of the block. False if there are loops, or too many ops to
/// have two copies.
bool EarlyTest::findGuards() {
  constexpr size_t most = 2000;
  DenseMap<Operation *, bool> known;
  bool isBehind = false;
  for (Operation &op : llvm::make_range(begin, block.end())) {
    isBehind |= isPart && hasGuardsInside(op);
    WalkResult walked = op.walk([&](Operation *inner) {
      if (first && (isa<LoopLikeOpInterface>(inner) || ++numOps > most))
        return WalkResult::interrupt();
      if (isBehind || !isGuard(inner))
        return WalkResult::advance();
      if (!first && op.walk([](LoopLikeOpInterface) {
                        return WalkResult::interrupt();
                      }).wasInterrupted())
        return WalkResult::interrupt();
      first = first ? first : &op;
      if (!isForConditions(inner, known))
        guards.push_back(cast<arith::SelectOp>(inner));
      return WalkResult::advance();
    });
    if (walked.wasInterrupted())
      return false;
  }
  return !guards.empty();
}

/// True if a value is computed before the first guard, or can be.
bool EarlyTest::canComeEarly(Value value) {
  Operation *around = value.getParentBlock()->findAncestorOpInBlock(*first);
  Operation *op = value.getDefiningOp();
  if (!around || !op)
    return around; // an argument of this block or one around it
  if (op->isBeforeInBlock(around))
    return true;
  if (value.getParentBlock() != &block || op->getNumRegions() != 0 ||
      isGuard(op))
    return false;
  auto [it, isNew] = isMovedEarly.try_emplace(op, false);
  if (!isNew)
    return it->second;
  auto onlyReads = [](Operation *op) {
    return isMemoryEffectFree(op) || hasSingleEffect<MemoryEffects::Read>(op);
  };
  bool result =
      onlyReads(op) && llvm::all_of(op->getOperands(), [&](Value operand) {
        return canComeEarly(operand);
      });
  if (result && !isMemoryEffectFree(op))
    for (Operation *before = first; before != op;
         before = before->getNextNode())
      result &= onlyReads(before);
  return isMovedEarly[op] = result;
}

/// Moves the computation of a value before the first guard.
void EarlyTest::moveEarly(Value value) {
  Operation *op = value.getDefiningOp();
  if (!op || op->getBlock() != &block || op->isBeforeInBlock(first))
    return;
  for (Value operand : op->getOperands())
    moveEarly(operand);
  op->moveBefore(first);
}

/// Moves the begin of the versions to where the test can be made: LLVM makes
/// vectors of floats of one block, but not of two.
void EarlyTest::moveBegin() {
  DenseSet<Operation *> needed;
  for (Value value : conditions.getFinite())
    needed.insert(value.getDefiningOp());
  for (Value value : conditions.getClear())
    needed.insert(value.getDefiningOp());
  while (Operation *before = first->getPrevNode()) {
    if (needed.contains(before) || before->getNumRegions() != 0)
      return;
    first = before;
  }
}

/// Emits each part of the test in the block of its values, which is outside of
/// loops that do not change them.
Value EarlyTest::createTest() {
  llvm::SmallSetVector<Block *, 4> blocks;
  for (Value value : conditions.getFinite())
    blocks.insert(value.getParentBlock());
  for (Value value : conditions.getClear())
    blocks.insert(value.getParentBlock());
  Value all;
  for (Block *from : blocks) {
    Operation *at = from->findAncestorOpInBlock(*first);
    OpBuilder builder(at);
    Value test = conditions.createTest(
        builder, guards.front().getLoc(),
        [&](Value value) { return value.getParentBlock() == from; });
    builder.setInsertionPoint(first);
    all = all ? Value(arith::AndIOp::create(builder, test.getLoc(), all, test))
              : test;
  }
  OpBuilder builder(first);
  return markLikely(builder, all);
}

bool EarlyTest::run() {
  if (!findGuards())
    return false;
  for (arith::SelectOp guard : guards)
    if (!conditions.require(guard, scope))
      return false;
  auto isThere = [&](Value value) { return canComeEarly(value); };
  conditions.simplify(isThere);
  if (conditions.count() == 0 ||
      conditions.count() > static_cast<int64_t>(guards.size()) ||
      !llvm::all_of(conditions.getFinite(), isThere) ||
      !llvm::all_of(conditions.getClear(), isThere))
    return false;
  for (Value value : conditions.getFinite())
    moveEarly(value);
  for (Value value : conditions.getClear())
    moveEarly(value);
  moveBegin();
  Value test = createTest();
  IRMapping bare;
  scf::IfOp branch = createVersions(first, test, bare, /*own=*/{});
  bareBlock = branch.thenBlock();
  // Selects in the derivatives of norms, which test for a norm of zero, are
  // removed as well.
  DenseSet<Value> nonZero;
  for (Value value : conditions.findNonZero())
    nonZero.insert(bare.lookupOrDefault(value));
  SmallVector<arith::SelectOp> removed;
  for (Operation &op : *bareBlock) {
    if (isPart && hasGuardsInside(op))
      break;
    op.walk([&](arith::SelectOp select) {
      if (isGuard(select) || nonZero.contains(getTestedForZero(select)))
        removed.push_back(select);
    });
  }
  for (arith::SelectOp guard : removed) {
    guard.getResult().replaceAllUsesWith(guard.getFalseValue());
    guard.erase();
  }
  return true;
}
