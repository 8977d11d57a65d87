//===- Guards.cpp - Branches around an update -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Guards.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// The branches of one loop around a store.
class Guards {
public:
  Guards(DifferentiableAccessInterface store, ParallelForOp loop,
         const SameIteration &same,
         ArrayRef<DifferentiableAccessInterface> accesses)
      : store(store), loop(loop), same(same), accesses(accesses) {}

  void join();

private:
  bool isInside(FlatSymbolRefAttr field, ValueRange indices) const;
  bool mayBeWritten(DifferentiableAccessInterface read) const;
  bool canRunAlways(Operation *op, Operation *before) const;
  bool canRunAlways(Block &block, Operation *but = nullptr) const;
  Value join(Value condition);

  DifferentiableAccessInterface store;
  ParallelForOp loop;
  const SameIteration &same;
  ArrayRef<DifferentiableAccessInterface> accesses;
};
} // namespace

/// True if the indices are those of the loop, and the field has an element for
/// each.
bool Guards::isInside(FlatSymbolRefAttr field, ValueRange indices) const {
  ParallelForOp visited = loop;
  if (!visited.isStructFor() ||
      !llvm::equal(indices, visited.getInductionVars()))
    return false;
  if (visited.getFieldAttr() == field)
    return true;
  FieldOp ours = lookupField(visited, visited.getFieldAttr());
  FieldOp theirs = lookupField(visited, field);
  if (!ours || !theirs)
    return false;
  FailureOr<FieldLayout> from = getFieldLayout(ours);
  FailureOr<FieldLayout> to = getFieldLayout(theirs);
  return succeeded(from) && succeeded(to) && from->shape == to->shape &&
         from->offset == to->offset;
}

/// True if another iteration may write the element. The condition may be there
/// to keep it from reading at the same time.
bool Guards::mayBeWritten(DifferentiableAccessInterface read) const {
  return !same.reachSame(read, store) &&
         llvm::any_of(accesses, [&](DifferentiableAccessInterface other) {
           return other.getAccessKind() != AccessKind::Read &&
                  getStorageKey(other) == getStorageKey(read);
         });
}

/// True if the op may run before the op `before`, which is around it.
bool Guards::canRunAlways(Operation *op, Operation *before) const {
  if (op->getNumRegions() == 0 && isPure(op))
    return true;
  auto read = dyn_cast<DifferentiableAccessInterface>(op);
  if (!read || read.getAccessKind() != AccessKind::Read)
    return false;
  // Fields without dimensions, the element that the loop visits, and elements
  // that the loop reads in any case.
  FlatSymbolRefAttr field = read.getAccessedStorage().field;
  bool areConstant = llvm::all_of(read.getAccessComponents(), [](Value part) {
    return matchPattern(part, m_Constant());
  });
  if (field && !mayBeWritten(read) && areConstant &&
      (read.getAccessIndices().empty() ||
       isInside(field, read.getAccessIndices())))
    return true;
  return llvm::any_of(accesses, [&](DifferentiableAccessInterface other) {
    Operation *next = other->getBlock()->findAncestorOpInBlock(*before);
    return other != read && other.getAccessKind() == AccessKind::Read && next &&
           other->isBeforeInBlock(next) && same.reachSame(other, read);
  });
}

bool Guards::canRunAlways(Block &block, Operation *but) const {
  return llvm::all_of(block.without_terminator(), [&](Operation &op) {
    return &op == but || canRunAlways(&op, block.getParentOp());
  });
}

/// The condition without branches, as far as that is possible.
Value Guards::join(Value condition) {
  if (auto both = condition.getDefiningOp<arith::AndIOp>()) {
    both.getLhsMutable().assign(join(both.getLhs()));
    both.getRhsMutable().assign(join(both.getRhs()));
    return condition;
  }
  auto branch = condition.getDefiningOp<scf::IfOp>();
  if (!branch || branch->getNumResults() != 1 ||
      !matchPattern(branch.elseYield().getOperand(0), m_Zero()))
    return condition;
  branch.getConditionMutable().assign(join(branch.getCondition()));
  scf::YieldOp yield = branch.thenYield();
  yield->setOperand(0, join(yield.getOperand(0)));
  if (!canRunAlways(*branch.thenBlock()) || !canRunAlways(*branch.elseBlock()))
    return condition;
  for (Operation &op :
       llvm::make_early_inc_range(branch.thenBlock()->without_terminator()))
    op.moveBefore(branch);
  OpBuilder b(branch);
  Value both = arith::AndIOp::create(b, branch.getLoc(), branch.getCondition(),
                                     yield.getOperand(0));
  branch.getResult(0).replaceAllUsesWith(both);
  branch.erase();
  return both;
}

void Guards::join() {
  Operation *op = store;
  scf::IfOp inner;
  while (op->getParentOp() != loop) {
    auto outer = dyn_cast<scf::IfOp>(op->getParentOp());
    if (!outer)
      return;
    outer.getConditionMutable().assign(join(outer.getCondition()));
    bool isAlone =
        inner && op == inner && outer->getNumResults() == 0 &&
        !outer.elseBlock() && inner->getNumResults() == 0 &&
        !inner.elseBlock() &&
        std::next(inner->getIterator()) == outer.thenYield()->getIterator() &&
        canRunAlways(*outer.thenBlock(), inner);
    if (!isAlone) {
      op = inner = outer;
      continue;
    }
    for (Operation &other :
         llvm::make_early_inc_range(outer.thenBlock()->without_terminator()))
      other.moveBefore(outer);
    OpBuilder b(inner);
    inner.getConditionMutable().assign(arith::AndIOp::create(
        b, inner.getLoc(), outer.getCondition(), inner.getCondition()));
    outer.erase();
    op = inner;
  }
}

void mlir::tai::joinGuards(DifferentiableAccessInterface store,
                           ParallelForOp loop, const SameIteration &same,
                           ArrayRef<DifferentiableAccessInterface> accesses) {
  Guards(store, loop, same, accesses).join();
}
