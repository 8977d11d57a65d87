//===- VersionGuards.cpp - Adjoints without guards, where they are finite -===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Guards keep products of zero and infinity out of adjoints. Outside of a few
// iterations no such product is met, yet each guard is a comparison and a
// select, or several, behind every multiplication: up to twice the time of a
// sweep. Here a block is computed without them, and one test of its results
// says whether that was right.
//
// The test is sound because adjoints are linear: between a guard and a result
// stand operations that make NaN of NaN, and NaN or infinity of infinity, in
// the component that is passed on. A select by a condition of the program may
// drop a component; it drops the guarded one as well.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Dialect/Tai/IR/Guards.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"
#include "llvm/ADT/SetVector.h"

namespace mlir::tai {
#define GEN_PASS_DEF_VERSIONGUARDS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

static bool isGuard(Operation *op) {
  return isa<arith::SelectOp>(op) &&
         (op->hasAttr(kGuard) || op->hasAttr(kInfiniteGuard));
}

/// Whether the op passes on what is not finite in its operand.
static bool passesOn(OpOperand &use) {
  Operation *op = use.getOwner();
  if (isa<arith::DivFOp>(op) || isa<arith::SelectOp>(op))
    return isa<arith::DivFOp>(op) ? use.getOperandNumber() == 0
                                  : use.getOperandNumber() != 0;
  return isa<arith::AddFOp, arith::SubFOp, arith::NegFOp, arith::MulFOp,
             arith::ExtFOp, arith::TruncFOp, vector::BroadcastOp,
             vector::ExtractOp, vector::FromElementsOp, vector::InsertOp,
             vector::ShapeCastOp, vector::ToElementsOp, vector::FMAOp,
             math::FmaOp, SumOp, TransposeOp, MatmulOp>(op);
}

/// Whether nothing hinders that the iterations of the innermost loop around the
/// block run side by side in the lanes of vectors.
static bool mayBeVectorized(Block &block) {
  Operation *loop = block.getParentOp();
  while (loop && !isa<LoopLikeOpInterface>(loop))
    loop = loop->getParentOp();
  if (!isa_and_nonnull<ParallelForOp>(loop))
    return false;
  // Loads of vectors, scatters and indices from memory keep loops scalar.
  return !loop->walk([&](Operation *op) {
                if (op != loop && isa<LoopLikeOpInterface>(op))
                  return WalkResult::interrupt();
                if (auto atomic = dyn_cast<AtomicOp>(op);
                    atomic && !atomic.getExclusive())
                  return WalkResult::interrupt();
                if (isa<MatmulOp, InverseOp, DeterminantOp>(op))
                  return WalkResult::interrupt();
                return WalkResult::advance();
              })
              .wasInterrupted();
}

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
  Value createTest(OpBuilder &builder, IRMapping &bare);
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

/// Whether the op makes NaN or infinity of a NaN or an infinity in any
/// component of the operand: none is dropped.
static bool keeps(OpOperand &use) {
  return passesOn(use) &&
         !isa<arith::SelectOp, vector::ExtractOp, vector::InsertOp,
              vector::ToElementsOp>(use.getOwner());
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
        return isGuard(user) ? use.getOperandNumber() == 2 : keeps(use);
      });
      if (isTold)
        tested.erase(value);
      if (isTold || tested.contains(value))
        told.insert(value);
    }
  return llvm::filter_to_vector(
      values, [&](Value value) { return tested.contains(value); });
}

static int64_t countComponents(ArrayRef<Value> values) {
  int64_t count = 0;
  for (Value value : values)
    if (auto vector = dyn_cast<VectorType>(value.getType()))
      count += vector.getNumElements();
    else
      ++count;
  return count;
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

/// Whether all that is tested is finite: then the sum is, if it does not
/// overflow, and zero times the sum is no NaN. That is not compared with zero,
/// since LLVM takes it for unlikely that floats are equal, and for likely that
/// they are ordered.
Value Segment::createTest(OpBuilder &builder, IRMapping &bare) {
  Location loc = guards.front()->getLoc();
  llvm::SmallMapVector<Type, SmallVector<Value>, 2> terms;
  for (Value tested : findTested()) {
    Value term = bare.lookupOrDefault(tested);
    if (isa<VectorType>(term.getType()))
      term = SumOp::create(builder, loc, getElementTypeOrSelf(term.getType()),
                           term);
    terms[term.getType()].push_back(term);
  }
  Value all;
  for (auto &[type, values] : terms) {
    // A tree, so that additions do not wait for each other.
    while (values.size() > 1) {
      SmallVector<Value> sums;
      for (size_t i = 0; i + 1 < values.size(); i += 2)
        sums.push_back(
            arith::AddFOp::create(builder, loc, values[i], values[i + 1]));
      if (values.size() % 2)
        sums.push_back(values.back());
      values = std::move(sums);
    }
    Value zero = arith::ConstantOp::create(
        builder, loc, cast<TypedAttr>(builder.getZeroAttr(type)));
    Value product = arith::MulFOp::create(builder, loc, values[0], zero);
    Value isFinite = arith::CmpFOp::create(
        builder, loc, arith::CmpFPredicate::ORD, product, product);
    all = all ? Value(arith::AndIOp::create(builder, loc, all, isFinite))
              : isFinite;
  }
  return all;
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
  Value isFinite = createTest(builder, bare);
  // What comes afterwards follows in both branches: results that wait for the
  // test would all be alive at once.
  Operation *terminator = block.getTerminator();
  SmallVector<Operation *> tail;
  for (Operation *op = end; op != terminator; op = op->getNextNode())
    tail.push_back(op);
  auto isInside = [&](Value value) {
    Operation *op = value.getDefiningOp();
    return op && (dependents.contains(op) || llvm::is_contained(tail, op));
  };
  SmallVector<OpOperand *> yielded;
  SmallVector<Type> types;
  SmallVector<Value> guardedResults, bareResults;
  for (OpOperand &operand : terminator->getOpOperands())
    if (isInside(operand.get())) {
      yielded.push_back(&operand);
      types.push_back(operand.get().getType());
      guardedResults.push_back(operand.get());
    }
  auto branch = scf::IfOp::create(builder, loc, types, isFinite,
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
  for (Operation *op : ops)
    if (dependents.contains(op) || conditions.contains(op))
      op->moveBefore(yield);
  for (Operation *op : tail)
    op->moveBefore(yield);
  // Partial derivatives that guards ask about, and what follows the test.
  sinkInto(guarded, branch);
  sinkInto(fast, branch);
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

/// Whether the op stays where it is, and what comes after it is apart.
static bool isBarrier(Operation *op) {
  return op->hasTrait<OpTrait::IsTerminator>() || op->getNumRegions() != 0 ||
         !(isMemoryEffectFree(op) || hasSingleEffect<MemoryEffects::Read>(op));
}

static void versionGuards(Block &block) {
  if (block.empty() ||
      !llvm::any_of(block, [](Operation &op) { return isGuard(&op); }))
    return;
  if (mayBeVectorized(block))
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
  void runOnOperation() override {
    SmallVector<Block *> blocks;
    getOperation()->walk([&](Operation *op) {
      for (Region &region : op->getRegions())
        for (Block &block : region)
          blocks.push_back(&block);
    });
    for (Block *block : blocks)
      versionGuards(*block);
  }
};
} // namespace
