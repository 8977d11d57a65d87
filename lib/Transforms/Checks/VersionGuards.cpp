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
  void hoist();
  void findConditions();
  bool findDependents();
  void findResults();
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

/// Moves what is pure and depends on nothing behind the end in front of it.
void Segment::hoist() {
  DenseSet<Operation *> behind;
  for (Operation &op : llvm::make_early_inc_range(
           llvm::make_range(end->getIterator(), block.end()))) {
    bool depends =
        &op == end || !isMovable(&op) || op.hasTrait<OpTrait::IsTerminator>();
    for (Value operand : op.getOperands())
      depends |=
          operand.getDefiningOp() && behind.contains(operand.getDefiningOp());
    if (depends)
      behind.insert(&op);
    else
      op.moveBefore(end);
  }
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
  DenseSet<Operation *> inside(ops.begin(), ops.end());
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

/// Those results that no other result tells about.
SmallVector<Value> Segment::findTested() {
  DenseSet<Value> tested(results.begin(), results.end()), told;
  for (Operation *op : llvm::reverse(dependents))
    for (Value value : op->getResults()) {
      bool isTold = llvm::any_of(value.getUses(), [&](OpOperand &use) {
        Operation *user = use.getOwner();
        if (!dependents.contains(user) || isGuard(user))
          return dependents.contains(user) && use.getOperandNumber() == 2 &&
                 told.contains(user->getResult(0));
        return keeps(use) && told.contains(user->getResult(0));
      });
      if (isTold)
        tested.erase(value);
      if (isTold || tested.contains(value))
        told.insert(value);
    }
  return llvm::filter_to_vector(
      results, [&](Value value) { return tested.contains(value); });
}

void Segment::findResults() {
  for (Operation *op : dependents)
    for (Value result : op->getResults())
      if (llvm::any_of(result.getUsers(), [&](Operation *user) {
            return !dependents.contains(user) && !conditions.contains(user);
          }))
        results.push_back(result);
}

/// Whether all results are finite: zero times each is zero, or NaN. The sum of
/// these is not compared with zero, since LLVM takes it for unlikely that
/// floats are equal, and for likely that they are ordered.
Value Segment::createTest(OpBuilder &builder, IRMapping &bare) {
  Location loc = guards.front()->getLoc();
  llvm::SmallMapVector<Type, SmallVector<Value>, 2> terms;
  for (Value result : findTested()) {
    Value value = bare.lookup(result);
    auto zero = arith::ConstantOp::create(
        builder, loc, cast<TypedAttr>(builder.getZeroAttr(value.getType())));
    Value term = arith::MulFOp::create(builder, loc, value, zero);
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
    Value isFinite = arith::CmpFOp::create(
        builder, loc, arith::CmpFPredicate::ORD, values[0], values[0]);
    all = all ? Value(arith::AndIOp::create(builder, loc, all, isFinite))
              : isFinite;
  }
  return all;
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
  SmallVector<Type> types;
  SmallVector<Value> bareResults;
  for (Value result : results) {
    types.push_back(result.getType());
    bareResults.push_back(bare.lookup(result));
  }
  auto branch = scf::IfOp::create(builder, loc, types, isFinite,
                                  /*withElseRegion=*/true);
  builder.setInsertionPointToStart(branch.thenBlock());
  scf::YieldOp::create(builder, loc, bareResults);
  builder.setInsertionPointToStart(branch.elseBlock());
  auto yield = scf::YieldOp::create(builder, loc, results);
  for (auto [result, replacement] : llvm::zip(results, branch.getResults()))
    result.replaceUsesWithIf(replacement, [&](OpOperand &use) {
      Operation *user = use.getOwner();
      return user != yield && !dependents.contains(user) &&
             !conditions.contains(user);
    });
  for (Operation *op : ops)
    if (dependents.contains(op) || conditions.contains(op))
      op->moveBefore(yield);
  // Partial derivatives that guards ask about, and nothing else.
  Block *guarded = branch.elseBlock();
  for (Operation *op = branch->getPrevNode(); op;) {
    Operation *candidate = std::exchange(op, op->getPrevNode());
    if (isMovable(candidate) && !candidate->use_empty() &&
        llvm::all_of(candidate->getUsers(), [&](Operation *user) {
          return user->getBlock() == guarded;
        }))
      candidate->moveBefore(guarded, guarded->begin());
  }
}

bool Segment::run(Operation *begin) {
  hoist();
  for (Operation *op = begin; op && op != end; op = op->getNextNode()) {
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
  // A test of a result costs about what a guard does.
  if (results.empty() || guards.size() + conditions.size() <= results.size())
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
    Operation *end = op, *next = op->getNextNode();
    Segment(block, end).run(begin);
    begin = op = next ? end->getNextNode() : nullptr;
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
