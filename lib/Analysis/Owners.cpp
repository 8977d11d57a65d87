//===- Owners.cpp - Iterations that own elements --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Owners.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"

using namespace mlir;
using namespace mlir::tai;

bool mlir::tai::holdsOwners(Value memory) {
  auto alloc = memory.getDefiningOp<memref::AllocOp>();
  if (!alloc || !alloc.getType().getElementType().isInteger())
    return false;
  Block *block = alloc->getBlock();
  bool isMaximum = false;
  Operation *firstRead = nullptr, *lastWrite = nullptr;
  for (Operation *user : alloc->getUsers()) {
    Operation *at = block->findAncestorOpInBlock(*user);
    if (!at)
      return false;
    auto update = dyn_cast<memref::AtomicRMWOp>(user);
    if (isa<memref::LoadOp>(user)) {
      if (!firstRead || at->isBeforeInBlock(firstRead))
        firstRead = at;
    } else if (isa<memref::StoreOp>(user) ||
               (update && update.getKind() == arith::AtomicRMWKind::maxs &&
                update->use_empty())) {
      isMaximum |= static_cast<bool>(update);
      if (!lastWrite || lastWrite->isBeforeInBlock(at))
        lastWrite = at;
    } else if (!isa<memref::DeallocOp>(user)) {
      return false;
    }
  }
  return isMaximum && (!firstRead || lastWrite->isBeforeInBlock(firstRead));
}

SmallVector<Operation *> mlir::tai::findOwnerSetters(Operation *alloc) {
  SmallVector<Operation *> setters;
  for (Operation *user : alloc->getUsers())
    if (isa<memref::StoreOp, memref::AtomicRMWOp>(user))
      setters.push_back(alloc->getBlock()->findAncestorOpInBlock(*user));
  llvm::sort(setters,
             [](Operation *a, Operation *b) { return a->isBeforeInBlock(b); });
  setters.erase(llvm::unique(setters), setters.end());
  return setters;
}

/// True if the condition is that this iteration owns an element.
static bool isOwnership(Value condition) {
  if (auto either = condition.getDefiningOp<arith::OrIOp>())
    return isOwnership(either.getLhs()) || isOwnership(either.getRhs());
  auto compare = condition.getDefiningOp<arith::CmpIOp>();
  if (!compare || compare.getPredicate() != arith::CmpIPredicate::eq)
    return false;
  return llvm::any_of(compare->getOperands(), [](Value value) {
    auto load = value.getDefiningOp<memref::LoadOp>();
    return load && holdsOwners(load.getMemRef());
  });
}

scf::IfOp mlir::tai::getOwnersBranch(Operation *op, Operation *scope) {
  for (Operation *parent = op->getParentOp(); parent && parent != scope;
       parent = parent->getParentOp())
    if (auto branch = dyn_cast<scf::IfOp>(parent);
        branch && isOwnership(branch.getCondition()))
      return branch;
  return nullptr;
}
