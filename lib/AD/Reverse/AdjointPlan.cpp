//===- AdjointPlan.cpp - The result of planning an adjoint ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Reverse/AdjointPlan.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

AdjointZeroing::AdjointZeroing(FunctionOpInterface primal,
                               const AccessTable &accesses,
                               const Activity &activity,
                               const AdjointOf &adjointOf, bool zeroesAll) {
  for (auto &[storage, list] : accesses.getStorages()) {
    SmallVector<DifferentiableAccessInterface> active, writes;
    for (DifferentiableAccessInterface access : list) {
      if (!isFloatOrVector(access.getAccessedValue().getType()) ||
          !adjointOf(access.getAccessedStorage()))
        continue;
      if (activity.isActiveAccess(access))
        active.push_back(access);
      if (access.getAccessKind() == AccessKind::Write)
        writes.push_back(access);
    }
    // An array that the function allocates gets no adjoint if none of its
    // accesses is active, and so there is nothing to zero.
    DifferentiableAccessInterface first = list.front();
    Value array = first.getAccessedStorage().memref;
    if (array && !isa<BlockArgument>(array) && active.empty())
      continue;
    for (DifferentiableAccessInterface store : writes)
      if (zeroesAll || store.getAccessedStorage().memref ||
          llvm::any_of(active, [&](auto access) {
            return mayReachLater(access, store);
          }))
        stores.insert(store);
  }
  for (Operation *store : stores)
    for (Operation *parent = store->getParentOp();
         parent != primal && holders.insert(parent).second;
         parent = parent->getParentOp())
      ;
}

Block *mlir::tai::getReexecutedBlock(Operation *op) {
  Operation *up = op;
  while (!isa<FunctionOpInterface>(up->getParentOp())) {
    up = up->getParentOp();
    if (isa<ParallelForOp, scf::ParallelOp>(up) && !isSerialLoop(up))
      return &up->getRegion(0).front();
  }
  return up->getBlock();
}

bool ReexecutionPlan::addRecorded(Operation *op) {
  if (!recorded.insert(op).second)
    return false;
  Block *block = getReexecutedBlock(op);
  blocks.insert(block);
  for (Operation *parent = op->getParentOp(); parent != block->getParentOp();
       parent = parent->getParentOp())
    holders.insert(parent);
  return true;
}

bool ReexecutionPlan::isRecorded(Value value) const {
  if (recorded.empty())
    return false;
  if (Operation *owner = value.getDefiningOp())
    return recorded.contains(owner) || holders.contains(owner);
  auto argument = cast<BlockArgument>(value);
  Operation *loop = argument.getOwner()->getParentOp();
  if (!holders.contains(loop))
    return false;
  auto forOp = dyn_cast<scf::ForOp>(loop);
  return forOp ? argument != forOp.getInductionVar() : isa<scf::WhileOp>(loop);
}

AdjointPlan::AdjointPlan(FunctionOpInterface primal, AdjointOf adjointOf,
                         ValueShadows shadows, AdjointOptions options)
    : primal(primal), adjointOf(std::move(adjointOf)),
      shadows(std::move(shadows)), options(options),
      activity(
          primal,
          [this](Storage storage) {
            return static_cast<bool>(this->adjointOf(storage));
          },
          this->shadows.inputs, this->shadows.outputs,
          /*assumeVaried=*/!options.skips.has(Skip::InactiveValues)),
      accesses(primal),
      zeroing(primal, accesses, activity, this->adjointOf, options.zeroesAll) {
  for (auto &[storage, list] : accesses.getStorages())
    for (DifferentiableAccessInterface access : list)
      if (access.getAccessKind() == AccessKind::Read &&
          activity.isActiveAccess(access))
        accumulated.insert(
            this->adjointOf(access.getAccessedStorage()).getOpaque());
}
