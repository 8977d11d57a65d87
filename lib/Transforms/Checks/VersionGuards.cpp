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

#include "FiniteConditions.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/ZeroTests.h"
#include "tai/Dialect/Tai/IR/Guards.h"
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
/// Versions the guards in the pure operations of a block that stand, or can be
/// moved, in front of an operation with effects.
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
  /// Ops that only conditions of guards use; ops that depend on a guard, in
  /// their order.
  llvm::SetVector<Operation *> conditions, dependents;
  /// Values of dependents that others use.
  SmallVector<Value> results;
};
} // namespace

/// True for an op without effects and regions, that may be moved.
static bool isMovable(Operation *op) {
  return op->getNumRegions() == 0 && mlir::isPure(op);
}

/// Moves what is pure and depends on nothing behind the end in front of it,
/// where there is a guard among that or in the segment.
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

/// From the last op to the first: those whose uses all end in conditions.
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

/// What guards decide, as far as the end; false if something among it may hide
/// that a value is not finite.
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

/// What must be finite for all guards to have no effect: the product that a
/// guard selects, and the adjoint that is multiplied behind a guard against
/// infinite adjoints.
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

/// Those of the values that no other of them tells about.
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

/// The values to test: results, or what guards look at, whichever are fewer.
SmallVector<Value> Segment::findTested() {
  SmallVector<Value> ofResults = prune(results),
                     ofFactors = prune(findFactors());
  return countComponents(ofFactors) < countComponents(ofResults) ? ofFactors
                                                                 : ofResults;
}

/// Whether a loop follows, or more than so many ops in all regions.
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

/// Moves what only ops of `to` use from in front of `branch` to the start of
/// that block.
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

/// Puts what stands from `begin` on in a block into both branches of an if: as
/// `bare` maps it, and as it is, behind `own`.
static scf::IfOp createVersions(Operation *begin, Value condition,
                                IRMapping &bare, ArrayRef<Operation *> own) {
  Block &block = *begin->getBlock();
  // What comes afterwards follows in both branches: results that wait for the
  // test would all be alive at once.
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
  // Partial derivatives that guards ask about, and what follows the test.
  sinkInto(guarded, branch);
  sinkInto(fast, branch);
  return branch;
}

static Value markLikely(OpBuilder &builder, Value condition) {
  Location loc = condition.getLoc();
  Value likely = arith::ConstantIntOp::create(builder, loc, /*value=*/1, 1);
  return LLVM::ExpectOp::create(builder, loc, condition, likely);
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
  // A test of a result costs about what a guard does. Code that is twice there
  // takes twice as long to compile.
  constexpr size_t most = 2000, mostBehind = 300;
  if (results.empty() || guards.size() + conditions.size() <= results.size() ||
      dependents.size() > most || hasMoreBehind(mostBehind))
    return false;
  emit();
  return true;
}

//===----------------------------------------------------------------------===//
// Tests before the guards
//===----------------------------------------------------------------------===//

namespace {
/// Versions all guards of a block by a test of what their partial derivatives
/// are computed from.
class EarlyTest {
public:
  explicit EarlyTest(Block &block)
      : block(block), scope(block), begin(block.begin()) {}
  /// For the guards from `begin` on that the block has itself, in front of the
  /// next op with guards in its regions. `apart` are ops in front of `begin`,
  /// in `scope`, whose results are tested.
  EarlyTest(Block &block, Block &scope, Block::iterator begin,
            const DenseSet<Operation *> &apart)
      : block(block), scope(scope), begin(begin), isPart(true) {
    conditions.setApart(apart);
  }
  bool run();
  /// After a run: the block that does not have these guards.
  Block &getBare() { return *bareBlock; }

private:
  bool findGuards();
  bool canComeEarly(Value value);
  void moveEarly(Value value);
  void moveBegin();
  Value createTest();

  Block &block, &scope;
  Block::iterator begin;
  bool isPart = false;
  Block *bareBlock = nullptr;
  /// Those whose results matter to more than conditions of guards.
  SmallVector<arith::SelectOp> guards;
  /// The first op in the block that is or has a guard.
  Operation *first = nullptr;
  size_t numOps = 0;
  FiniteConditions conditions;
  /// Of ops behind the first guard, whether they can be in front of it.
  DenseMap<Operation *, bool> isMovedEarly;
};
} // namespace

/// Whether nothing but conditions of guards uses the op.
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

static bool hasGuardsInside(Operation &op) {
  return op.getNumRegions() != 0 && op.walk([](Operation *inner) {
                                        return isGuard(inner)
                                                   ? WalkResult::interrupt()
                                                   : WalkResult::advance();
                                      }).wasInterrupted();
}

/// False if there are loops, or too much to have it twice.
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

/// Whether a value is there before the first guard, or can be.
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

/// Moves what a value is computed from in front of the first guard.
void EarlyTest::moveEarly(Value value) {
  Operation *op = value.getDefiningOp();
  if (!op || op->getBlock() != &block || op->isBeforeInBlock(first))
    return;
  for (Value operand : op->getOperands())
    moveEarly(operand);
  op->moveBefore(first);
}

/// Lets the versions begin as soon as the test can be made: LLVM puts floats of
/// one block into vectors, and not those of two.
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

/// Each part of the test where its values are: in front of a loop that does not
/// change them.
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
  // What derivatives of norms choose where a norm is zero.
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

/// Whether the op stays where it is, and what comes after it is apart.
static bool isBarrier(Operation *op) {
  return op->hasTrait<OpTrait::IsTerminator>() || op->getNumRegions() != 0 ||
         !(isMemoryEffectFree(op) || hasSingleEffect<MemoryEffects::Read>(op));
}

static void versionGuards(Block &block);

/// Versions the guards of a block, which has some in regions of its ops too, by
/// a test for each part between these. False if no part can be tested.
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
    for (Region &region : getOperation()->getRegions())
      for (Block &block : region)
        versionGuards(block);
  }
};
} // namespace
