//===- SinkAdjoints.cpp - Contributions of one arm go into it -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The reverse of a branch returns adjoints, and zeros from an arm that has no
// adjoints. The code after it is the reverse of the primal code before the
// branch. If the only effects of this code are to add products of those
// adjoints, it does nothing where they are zero, and moves to the end of the
// other arm.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/SkipScope.h"
#include "tai/Analysis/ZeroAdjoints.h"
#include "tai/Dialect/Tai/IR/Guards.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Utils/Vectorization.h"

namespace mlir::tai {
#define GEN_PASS_DEF_SINKADJOINTS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

namespace {
/// Sinks the code after a branch into one of its arms.
class Sinking {
public:
  /// Sinks ops into an arm of a branch. `zeroArm`, the arm that yields zeros,
  /// is 0 for then and 1 for else.
  Sinking(scf::IfOp branch, unsigned zeroArm)
      : branch(branch), zeroArm(zeroArm) {}
  bool run();

private:
  Operation *getYield(unsigned arm) {
    return branch->getRegion(arm).front().getTerminator();
  }
  bool isZero(Value value) const {
    return zeros.contains(value) || matchPattern(value, m_AnyZeroFloat());
  }
  bool isTail(Operation *op) const {
    return op && op->getBlock() == branch->getBlock() &&
           branch->isBeforeInBlock(op);
  }
  bool collect();
  Value skipZeros(Value value) const;
  bool countClones(Value value);
  Value getInZeroArm(Value value, OpBuilder &builder, IRMapping &mapping);
  void emit();

  scf::IfOp branch;
  unsigned zeroArm;
  SmallVector<Operation *> tail;
  DenseSet<Value> zeros;
  /// Operands of the block's terminator that are computed by ops after the
  /// branch.
  SmallVector<OpOperand *> yielded;
  DenseSet<Operation *> cloned;
};
} // namespace

/// Finds the ops after the branch, the tail, and its values that are zero if
/// `zeroArm` runs. False if the tail does more than add zeros in that case.
bool Sinking::collect() {
  for (Value operand : getYield(zeroArm)->getOperands())
    if (!matchPattern(operand, m_AnyZeroFloat()))
      return false;
  zeros.insert(branch->result_begin(), branch->result_end());
  Block &block = *branch->getBlock();
  for (Operation &op : llvm::make_range(std::next(branch->getIterator()),
                                        std::prev(block.end()))) {
    if (op.getNumRegions() != 0)
      return false;
    for (Operation *user : op.getUsers())
      if (!block.findAncestorOpInBlock(*user))
        return false;
    if (auto atomic = dyn_cast<AtomicOp>(op)) {
      if ((atomic.getKind() != AtomicKind::Add &&
           atomic.getKind() != AtomicKind::Sub) ||
          !atomic.getOld().use_empty() || !isZero(atomic.getValue()))
        return false;
    } else if (!isMemoryEffectFree(&op) &&
               !hasSingleEffect<MemoryEffects::Read>(&op)) {
      return false;
    }
    tail.push_back(&op);
    for (OpResult result : op.getResults())
      if (isa<FloatType>(getElementTypeOrSelf(result.getType())) &&
          isZeroOfZeros(result, [&](Value v) { return isZero(v); }))
        zeros.insert(result);
  }
  for (OpOperand &operand : block.getTerminator()->getOpOperands()) {
    Operation *op = operand.get().getDefiningOp();
    if (op != branch && !isTail(op))
      continue;
    yielded.push_back(&operand);
    if (!countClones(operand.get()))
      return false;
  }
  return llvm::any_of(tail, [](Operation *op) {
    return !op->hasTrait<OpTrait::ConstantLike>();
  });
}

/// Strips additions and subtractions of zeros from `value`.
Value Sinking::skipZeros(Value value) const {
  while (!isZero(value) && isTail(value.getDefiningOp())) {
    auto sum = value.getDefiningOp<arith::AddFOp>();
    auto difference = value.getDefiningOp<arith::SubFOp>();
    if (sum && isZero(sum.getLhs()))
      value = sum.getRhs();
    else if (sum && isZero(sum.getRhs()))
      value = sum.getLhs();
    else if (difference && isZero(difference.getRhs()))
      value = difference.getLhs();
    else
      break;
  }
  return value;
}

/// Counts the ops after the branch that `zeroArm` needs for `value` as well.
/// False if they are too many to be cloned.
bool Sinking::countClones(Value value) {
  constexpr size_t most = 8;
  value = skipZeros(value);
  Operation *op = value.getDefiningOp();
  if (isZero(value) || !isTail(op) || !cloned.insert(op).second)
    return true;
  return cloned.size() <= most &&
         llvm::all_of(op->getOperands(),
                      [&](Value operand) { return countClones(operand); });
}

Value Sinking::getInZeroArm(Value value, OpBuilder &builder,
                            IRMapping &mapping) {
  value = skipZeros(value);
  if (mapping.contains(value))
    return mapping.lookup(value);
  if (zeros.contains(value)) {
    Value zero = arith::ConstantOp::create(
        builder, value.getLoc(),
        cast<TypedAttr>(builder.getZeroAttr(value.getType())));
    mapping.map(value, zero);
    return zero;
  }
  Operation *op = value.getDefiningOp();
  if (!isTail(op))
    return value;
  for (Value operand : op->getOperands())
    mapping.map(operand, getInZeroArm(operand, builder, mapping));
  builder.clone(*op, mapping);
  return mapping.lookup(value);
}

void Sinking::emit() {
  OpBuilder builder(branch);
  Location loc = branch.getLoc();
  SmallVector<Type> types;
  for (OpOperand *operand : yielded)
    types.push_back(operand->get().getType());
  auto sunk = scf::IfOp::create(builder, loc, types, branch.getCondition(),
                                /*addThenBlock=*/false,
                                /*addElseBlock=*/false);
  for (unsigned arm : {0, 1})
    sunk->getRegion(arm).takeBody(branch->getRegion(arm));

  Operation *zeroYield = sunk->getRegion(zeroArm).front().getTerminator();
  builder.setInsertionPoint(zeroYield);
  IRMapping mapping;
  SmallVector<Value> rest;
  for (OpOperand *operand : yielded)
    rest.push_back(getInZeroArm(operand->get(), builder, mapping));
  scf::YieldOp::create(builder, loc, rest);
  zeroYield->erase();

  Operation *yield = sunk->getRegion(1 - zeroArm).front().getTerminator();
  for (Operation *op : tail)
    op->moveBefore(yield);
  branch->replaceAllUsesWith(yield->getOperands());
  builder.setInsertionPoint(yield);
  SmallVector<Value> results;
  for (OpOperand *operand : yielded)
    results.push_back(operand->get());
  scf::YieldOp::create(builder, loc, results);
  yield->erase();
  for (auto [operand, result] : llvm::zip(yielded, sunk.getResults()))
    operand->set(result);
  branch->erase();
}

bool Sinking::run() {
  if (!collect())
    return false;
  emit();
  return true;
}

namespace {
struct SinkAdjoints : tai::impl::SinkAdjointsBase<SinkAdjoints> {
  void runOnOperation() override {
    SmallVector<scf::IfOp> branches;
    getOperation()->walk([&](scf::IfOp branch) {
      if (branch->hasAttr(kAdjointBranch) && branch.elseBlock())
        branches.push_back(branch);
    });
    for (scf::IfOp branch : branches) {
      SkipScope::count(SkipCount::BranchesReversed, 1);
      if (mayBeVectorized(*branch->getBlock()))
        continue;
      if (Sinking(branch, 1).run() || Sinking(branch, 0).run())
        SkipScope::count(SkipCount::BranchesSunkInto, 1);
    }
  }
};
} // namespace
