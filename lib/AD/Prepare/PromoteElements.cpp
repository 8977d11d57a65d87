//===- PromoteElements.cpp - Store-to-load forwarding in fields -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Scopes are the blocks of a function, from the outermost to the innermost. In
// each scope, the accesses at the same indices are a group, which is kept in a
// variable if nothing else in the scope can access the element.
//
//===----------------------------------------------------------------------===//

#include "../SelectedFunctionsPass.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "tai/AD/Passes.h"
#include "tai/AD/Prepare/Selection.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {
#define GEN_PASS_DEF_PROMOTEELEMENTS
#include "tai/AD/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

namespace {
/// The accesses to one element within a scope (a block), in program order.
struct Group {
  SmallVector<IndexExpr> indices, components;
  Accesses accesses;
};

/// Works on one scope.
class Scope {
public:
  explicit Scope(Block *block) : block(block) {}

  void run();

private:
  bool isVisible(Value value);
  bool sees(ArrayRef<IndexExpr> forms);
  bool canLive(Group &group, ArrayRef<DifferentiableAccessInterface> all);
  bool isOwned(Group &group);
  bool needsVariable(const Group &group);
  bool isCertain(Operation *access);
  DifferentiableAccessInterface findLeader(const Group &group);
  void rewrite(const Group &group, DifferentiableAccessInterface leader);

  Block *block;
};
} // namespace

static bool isWrite(DifferentiableAccessInterface access) {
  return access.getAccessKind() != AccessKind::Read;
}

/// True if `value` is defined in the block of the scope or outside of it, and
/// not in a nested region, so that it does not change during one run of the
/// scope.
bool Scope::isVisible(Value value) {
  return value.getParentBlock()->getParentOp()->isAncestor(
      block->getParentOp());
}

bool Scope::sees(ArrayRef<IndexExpr> forms) {
  return llvm::all_of(forms, [&](const IndexExpr &form) {
    return form.allOf([&](Value value) { return isVisible(value); });
  });
}

/// True if each run of the scope executes `access`: it is under no condition,
/// and in no loop that is possibly empty.
bool Scope::isCertain(Operation *access) {
  for (Operation *up = access; up->getBlock() != block;
       up = up->getParentOp()) {
    auto loop = dyn_cast<scf::ForOp>(up->getParentOp());
    APInt lower, upper;
    if (!loop || !matchPattern(loop.getLowerBound(), m_ConstantInt(&lower)) ||
        !matchPattern(loop.getUpperBound(), m_ConstantInt(&upper)) ||
        lower.sge(upper))
      return false;
  }
  return true;
}

/// True if the group needs a variable: neither the memory before the scope runs
/// nor the memory afterwards holds all values that the group reads.
bool Scope::needsVariable(const Group &group) {
  bool lost = false, changed = false;
  for (DifferentiableAccessInterface read : group.accesses) {
    if (isWrite(read))
      continue;
    for (DifferentiableAccessInterface write : group.accesses)
      if (isWrite(write)) {
        lost |= mayReachLater(read, write, block);
        changed |= mayReachLater(write, read, block);
      }
  }
  return lost && changed;
}

/// True if no other iteration of the enclosing parallel loop can access the
/// group's element.
bool Scope::isOwned(Group &group) {
  if (llvm::any_of(group.accesses, [&](auto access) {
        return access.getAccessKind() == AccessKind::Write && isCertain(access);
      }))
    return true;
  // The element of a sparse field is not kept in a variable: storing the
  // variable back could activate a cell.
  if (FlatSymbolRefAttr name =
          group.accesses.front().getAccessedStorage().field) {
    FieldLayout layout =
        *getFieldLayout(lookupField(group.accesses.front(), name));
    if (layout.path.getFirstSparse())
      return false;
  }
  // Accesses of the element in other blocks of the parallel loop count as well.
  Operation *loop = getOutermostParallelLoop(block->getTerminator());
  if (!loop)
    return true;
  SmallVector<Operation *> all;
  const void *key = getStorageKey(group.accesses.front());
  loop->walk([&](DifferentiableAccessInterface access) {
    if (getStorageKey(access) == key)
      all.push_back(access);
  });
  return isExclusive(all);
}

bool Scope::canLive(Group &group, ArrayRef<DifferentiableAccessInterface> all) {
  if (!sees(group.indices) || !sees(group.components) ||
      !needsVariable(group) || llvm::none_of(group.accesses, [&](auto access) {
        return isCertain(access);
      }))
    return false;
  for (DifferentiableAccessInterface access : group.accesses) {
    // An update can be replaced only if its result is the former value of the
    // element, as that of `tai.atomic` is, or is unused.
    if (access.getAccessKind() == AccessKind::Update ||
        (access.getAccessKind() == AccessKind::Accumulate &&
         !isa<AtomicOp>(access) && !access->use_empty()))
      return false;
    for (Operation *up = access->getParentOp(); up != block->getParentOp();
         up = up->getParentOp())
      if (!isa<scf::IfOp, scf::ForOp, scf::WhileOp>(up))
        return false;
  }
  for (DifferentiableAccessInterface other : all) {
    if (llvm::is_contained(group.accesses, other))
      continue;
    for (DifferentiableAccessInterface own : group.accesses)
      if ((isWrite(own) || isWrite(other)) &&
          (mayReachLater(own, other, block) ||
           mayReachLater(other, own, block)))
        return false;
  }
  return isOwned(group);
}

/// Returns an access of the group whose index operands are computed before the
/// group's first access, so that the variable can be loaded there; or null.
DifferentiableAccessInterface Scope::findLeader(const Group &group) {
  Operation *before = block->findAncestorOpInBlock(*group.accesses.front());
  auto isKnown = [&](Value value) {
    Operation *owner = value.getDefiningOp();
    return isVisible(value) && (!owner || owner->getBlock() != block ||
                                owner->isBeforeInBlock(before));
  };
  for (DifferentiableAccessInterface access : group.accesses)
    if (llvm::all_of(access.getAccessIndices(), isKnown) &&
        llvm::all_of(access.getAccessComponents(), isKnown))
      return access;
  return {};
}

static Value createSum(OpBuilder &b, DifferentiableAccessInterface access,
                       Value old) {
  Location loc = access.getLoc();
  Value value = access.getAccessedValue();
  bool isFloat = isa<FloatType>(getElementTypeOrSelf(value.getType()));
  if (access.isNegated())
    return isFloat ? arith::SubFOp::create(b, loc, old, value).getResult()
                   : arith::SubIOp::create(b, loc, old, value).getResult();
  return isFloat ? arith::AddFOp::create(b, loc, old, value).getResult()
                 : arith::AddIOp::create(b, loc, old, value).getResult();
}

void Scope::rewrite(const Group &group, DifferentiableAccessInterface leader) {
  Operation *first = block->findAncestorOpInBlock(*group.accesses.front());
  Operation *last = block->findAncestorOpInBlock(*group.accesses.back());
  Type type = leader.getAccessedValue().getType();
  Storage storage = leader.getAccessedStorage();
  SmallVector<Value> indices(leader.getAccessIndices());
  SmallVector<Value> components(leader.getAccessComponents());
  OpBuilder b(first);
  Value variable = AllocaOp::create(b, leader.getLoc(), LocalType::get(type));
  LocalStoreOp::create(
      b, leader.getLoc(),
      leader.createAdjointRead(b, storage, indices, components), variable);
  b.setInsertionPointAfter(last);
  leader.createAdjointStore(
      b, LocalLoadOp::create(b, last->getLoc(), type, variable), storage,
      indices, components);
  for (DifferentiableAccessInterface access : group.accesses) {
    b.setInsertionPoint(access);
    Location loc = access.getLoc();
    if (access.getAccessKind() == AccessKind::Write) {
      LocalStoreOp::create(b, loc, access.getAccessedValue(), variable);
    } else {
      Value old = LocalLoadOp::create(b, loc, type, variable);
      if (isWrite(access))
        LocalStoreOp::create(b, loc, createSum(b, access, old), variable);
      access->replaceAllUsesWith(ValueRange{old});
    }
    access->erase();
  }
}

void Scope::run() {
  llvm::MapVector<const void *, Accesses> byStorage;
  for (Operation &op : *block)
    op.walk([&](DifferentiableAccessInterface access) {
      byStorage[getStorageKey(access)].push_back(access);
    });
  for (auto &[storage, all] : byStorage) {
    if (llvm::none_of(all, isWrite))
      continue;
    SmallVector<Group, 1> groups;
    for (DifferentiableAccessInterface access : all) {
      SmallVector<IndexExpr> indices = getIndexExprs(access.getAccessIndices());
      SmallVector<IndexExpr> components =
          getIndexExprs(access.getAccessComponents());
      auto *group = llvm::find_if(groups, [&](const Group &candidate) {
        return candidate.indices == indices &&
               candidate.components == components;
      });
      if (group == groups.end())
        group = &groups.emplace_back(Group{indices, components, {}});
      group->accesses.push_back(access);
    }
    // After one group has been rewritten, the remaining accesses must be
    // grouped again.
    for (Group &group : groups)
      if (DifferentiableAccessInterface leader = findLeader(group);
          leader && canLive(group, all)) {
        rewrite(group, leader);
        return run();
      }
  }
}

/// Handles the blocks of a function as scopes, outermost first. The arms of
/// branches are scopes too: elements that they store are their own.
static void visit(Block &block) {
  Scope(&block).run();
  for (Operation &op : block)
    for (Region &region : op.getRegions())
      for (Block &inner : region)
        visit(inner);
}

namespace {
struct PromoteElements
    : SelectedFunctionsPass<PromoteElements, tai::impl::PromoteElementsBase> {
  using SelectedFunctionsPass::SelectedFunctionsPass;

  LogicalResult runOnFunction(FunctionOpInterface function) {
    if (function.getFunctionBody().hasOneBlock())
      visit(function.getFunctionBody().front());
    return success();
  }
};
} // namespace
