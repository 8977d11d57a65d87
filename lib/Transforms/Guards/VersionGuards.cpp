//===- VersionGuards.cpp - Adjoints without guards, where they are finite -===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Guards keep products of zero and infinity out of adjoints. Such products are
// rare, yet each guard is one or more comparisons and selects after every
// multiplication: up to twice the time of a sweep. Here a block is computed
// without guards, if one test of the inputs of its partial derivatives shows
// that all are finite.
//
// Where that is not known before the first guard, the results are tested. That
// is sound because adjoints are linear: between a guard and a result
// stand operations that make NaN of NaN, and NaN or infinity of infinity, in
// the component that is passed on. A select by a condition of the program may
// drop a component; it drops the guarded one as well.
//
//===----------------------------------------------------------------------===//

#include "GuardVersions.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Utils/Vectorization.h"
#include "llvm/ADT/SetVector.h"

namespace mlir::tai {
#define GEN_PASS_DEF_VERSIONGUARDS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

namespace {
/// Versions the guards among the pure operations of a block that are, or can be
/// moved, before an operation with effects.
class Segment {
public:
  Segment(Block &block, Operation *end) : block(block), end(end) {}
  bool run(Operation *begin);

private:
  void hoist(Operation *begin);
  void findConditions();
  bool findDependents();
  bool hasMoreBehind(size_t most);
  void findResults();
  SmallVector<Value> findFactors();
  SmallVector<Value> prune(ArrayRef<Value> values);
  SmallVector<Value> findTested();
  void emit();

  Block &block;
  Operation *end;
  SmallVector<Operation *> ops, guards;
  /// Ops that only conditions of guards use; and ops that depend on a guard, in
  /// program order.
  llvm::SetVector<Operation *> conditions, dependents;
  /// Results of the ops that depend on guards which other ops use.
  SmallVector<Value> results;
};
} // namespace

/// Moves pure ops from after `end` before it, as far as their operands allow,
/// if there is a guard among these ops or in the segment.
void Segment::hoist(Operation *begin) {
  DenseSet<Operation *> behind;
  SmallVector<Operation *> movable;
  for (Operation &op : llvm::make_range(end->getIterator(), block.end())) {
    bool depends =
        &op == end || !isMovable(&op) || op.hasTrait<OpTrait::IsTerminator>();
    for (Value operand : op.getOperands())
      depends |=
          operand.getDefiningOp() && behind.contains(operand.getDefiningOp());
    if (depends)
      behind.insert(&op);
    else
      movable.push_back(&op);
  }
  bool hasGuards = llvm::any_of(movable, isGuard);
  for (Operation *op = begin; op != end; op = op->getNextNode())
    hasGuards |= isGuard(op);
  if (hasGuards)
    for (Operation *op : movable)
      op->moveBefore(end);
}

/// Finds the ops of the segment whose uses all end in conditions of guards,
/// from the last op to the first.
void Segment::findConditions() {
  DenseSet<Operation *> inside(ops.begin(), ops.end());
  for (Operation *op : llvm::reverse(ops)) {
    if (!isMovable(op) || isGuard(op) || op->use_empty())
      continue;
    if (llvm::all_of(op->getUses(), [&](OpOperand &use) {
          Operation *user = use.getOwner();
          return conditions.contains(user) ||
                 (inside.contains(user) && isGuard(user) &&
                  use.getOperandNumber() == 0);
        }))
      conditions.insert(op);
  }
}

/// Finds the ops up to `end` that depend on guards; false if one of them may
/// hide that a value is not finite.
bool Segment::findDependents() {
  DenseSet<Operation *> reached(guards.begin(), guards.end());
  for (Operation *op : ops) {
    if (conditions.contains(op))
      continue;
    for (OpOperand &operand : op->getOpOperands()) {
      Operation *from = operand.get().getDefiningOp();
      if (!from || !reached.contains(from))
        continue;
      if (isGuard(op) && operand.getOperandNumber() == 0)
        continue;
      if (!passesOn(operand))
        return false;
      reached.insert(op);
    }
    if (reached.contains(op))
      dependents.insert(op);
  }
  return true;
}

/// The values whose finiteness makes all guards ineffective: the product that a
/// guard selects, or, for a guard against infinite adjoints, the adjoint in the
/// product.
SmallVector<Value> Segment::findFactors() {
  llvm::SetVector<Value> factors;
  auto add = [&](Value value) {
    while (auto broadcast = value.getDefiningOp<vector::BroadcastOp>())
      value = broadcast.getSource();
    factors.insert(value);
  };
  for (Operation *guard : guards) {
    Value product = guard->getOperand(2);
    Operation *op = product.getDefiningOp();
    SmallVector<Value> seeds;
    if (guard->hasAttr(kInfiniteGuard) && op && op->getBlock() == &block &&
        OpTrait::hasElementwiseMappableTraits(op))
      for (Value operand : op->getOperands())
        if (operand.getDefiningOp() &&
            dependents.contains(operand.getDefiningOp()))
          seeds.push_back(operand);
    if (seeds.empty())
      seeds.push_back(product);
    for (Value seed : seeds)
      add(seed);
  }
  return factors.takeVector();
}

/// Drops those values whose finiteness follows from the finiteness of other
/// values.
SmallVector<Value> Segment::prune(ArrayRef<Value> values) {
  DenseSet<Value> tested(values.begin(), values.end()), told;
  for (Operation *op : llvm::reverse(ops))
    for (Value value : op->getResults()) {
      bool isTold = llvm::any_of(value.getUses(), [&](OpOperand &use) {
        Operation *user = use.getOwner();
        if (user->getNumResults() != 1 || !told.contains(user->getResult(0)))
          return false;
        return isGuard(user) ? use.getOperandNumber() == 2
                             : keepsNonFinite(use);
      });
      if (isTold)
        tested.erase(value);
      if (isTold || tested.contains(value))
        told.insert(value);
    }
  return llvm::filter_to_vector(
      values, [&](Value value) { return tested.contains(value); });
}

/// Chooses the values that are tested at run time: the results of the segment
/// or the operands of its guards, whichever have fewer components. Either
/// choice shows that all values are finite.
SmallVector<Value> Segment::findTested() {
  SmallVector<Value> ofResults = prune(results),
                     ofFactors = prune(findFactors());
  return countComponents(ofFactors) < countComponents(ofResults) ? ofFactors
                                                                 : ofResults;
}

/// True if a loop follows in the block, or more than `most` ops.
bool Segment::hasMoreBehind(size_t most) {
  size_t count = 0;
  for (Operation &op : llvm::make_range(end->getIterator(), block.end())) {
    WalkResult walked = op.walk([&](Operation *inner) {
      return isa<LoopLikeOpInterface>(inner) || ++count > most
                 ? WalkResult::interrupt()
                 : WalkResult::advance();
    });
    if (walked.wasInterrupted())
      return true;
  }
  return false;
}

void Segment::findResults() {
  for (Operation *op : dependents)
    for (Value result : op->getResults())
      if (llvm::any_of(result.getUsers(), [&](Operation *user) {
            return !dependents.contains(user) && !conditions.contains(user);
          }))
        results.push_back(result);
}

void Segment::emit() {
  Location loc = guards.front()->getLoc();
  OpBuilder builder(end);
  IRMapping bare;
  for (Operation *op : dependents) {
    if (isGuard(op))
      bare.map(op->getResult(0), bare.lookupOrDefault(op->getOperand(2)));
    else
      builder.clone(*op, bare);
  }
  SmallVector<Value> tested;
  for (Value value : findTested())
    tested.push_back(bare.lookupOrDefault(value));
  Value isFinite =
      markLikely(builder, createTestOfFinite(builder, loc, tested));
  SmallVector<Operation *> own;
  for (Operation *op : ops)
    if (dependents.contains(op) || conditions.contains(op))
      own.push_back(op);
  createVersions(end, isFinite, bare, own);
}

bool Segment::run(Operation *begin) {
  hoist(begin);
  for (Operation *op = begin; op != end; op = op->getNextNode()) {
    ops.push_back(op);
    if (isGuard(op))
      guards.push_back(op);
  }
  if (guards.empty())
    return false;
  findConditions();
  if (!findDependents())
    return false;
  findResults();
  // A test of a result costs about as much as a guard. Duplicated code takes
  // twice as long to compile.
  constexpr size_t most = 2000, mostBehind = 300;
  if (results.empty() || guards.size() + conditions.size() <= results.size() ||
      dependents.size() > most || hasMoreBehind(mostBehind))
    return false;
  emit();
  return true;
}

/// True if the op stays in its place, and separates the ops before it from the
/// ops after it.
static bool isBarrier(Operation *op) {
  return op->hasTrait<OpTrait::IsTerminator>() || op->getNumRegions() != 0 ||
         !(isMemoryEffectFree(op) || hasSingleEffect<MemoryEffects::Read>(op));
}

static void versionGuards(Block &block);

/// Versions the guards of a block that also has guards in regions of its ops,
/// by a test for each part between these ops. False if no part can be tested.
static bool versionParts(Block &start) {
  if (llvm::none_of(start, hasGuardsInside))
    return false;
  Block *block = &start;
  Block::iterator begin = block->begin();
  DenseSet<Operation *> apart;
  SmallVector<Operation *> between;
  while (true) {
    EarlyTest test(*block, start, begin, apart);
    if (test.run()) {
      block = &test.getBare();
      begin = block->begin();
    }
    for (; begin != block->end() && !hasGuardsInside(*begin); ++begin)
      if (isGuard(&*begin))
        apart.insert(&*begin);
    if (begin == block->end())
      break;
    between.push_back(&*begin);
    apart.insert(&*begin);
    ++begin;
  }
  if (block == &start)
    return false;
  for (Operation *op : between)
    for (Region &region : op->getRegions())
      for (Block &nested : region)
        versionGuards(nested);
  return true;
}

static void versionGuards(Block &block) {
  if (block.empty())
    return;
  bool hasGuards =
      llvm::any_of(block, [](Operation &op) { return isGuard(&op); }) &&
      !mayBeVectorized(block);
  if (hasGuards && (EarlyTest(block).run() || versionParts(block)))
    return;
  SmallVector<Block *> inner;
  for (Operation &op : block)
    for (Region &region : op.getRegions())
      for (Block &nested : region)
        inner.push_back(&nested);
  for (Block *nested : inner)
    versionGuards(*nested);
  if (!hasGuards)
    return;
  Operation *begin = &block.front();
  for (Operation *op = begin; op;) {
    if (!isBarrier(op)) {
      op = op->getNextNode();
      continue;
    }
    if (Segment(block, op).run(begin))
      return;
    begin = op = op->getNextNode();
  }
}

namespace {
struct VersionGuards : tai::impl::VersionGuardsBase<VersionGuards> {
  void getDependentDialects(DialectRegistry &registry) const override {
    VersionGuardsBase::getDependentDialects(registry);
    registry.insert<LLVM::LLVMDialect>();
  }
  void runOnOperation() override {
    walkOwned(getOperation(), [](Operation *owned) {
      for (Region &region : owned->getRegions())
        for (Block &block : region)
          versionGuards(block);
    });
  }
};
} // namespace
