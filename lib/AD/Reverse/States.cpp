//===- States.cpp - Which contents of memory an adjoint reads -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An adjoint runs on the memory that the kernel left behind, or, field by
// field, on what was there before. Which of them holds the value of a read
// depends on the writes that may come before and after it.
//
//===----------------------------------------------------------------------===//

#include "tai/AD/AdjointBuilder.h"
#include "tai/AD/Rerun.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

/// Finds the stores that take the adjoints of their elements: those of elements
/// that an earlier access of the kernel may have used, for its reverse must not
/// see the adjoint of the stored value. Those of arrays all do, because a tape
/// does not know which elements another launch has used.
void AdjointBuilder::findTakes() {
  for (auto &[storage, list] : accesses.getStorages()) {
    SmallVector<DifferentiableAccessInterface> active, stores;
    for (DifferentiableAccessInterface access : list) {
      if (!isFloatOrVector(access.getAccessedValue().getType()) ||
          !adjointOf(access.getAccessedStorage()))
        continue;
      if (activity.isActiveAccess(access))
        active.push_back(access);
      if (access.getAccessKind() == AccessKind::Write)
        stores.push_back(access);
    }
    for (DifferentiableAccessInterface store : stores)
      if (takesAll || store.getAccessedStorage().memref ||
          llvm::any_of(active, [&](auto access) {
            return mayReachLater(access, store);
          }))
        takes.insert(store);
  }
  for (Operation *store : takes)
    for (Operation *parent = store->getParentOp();
         parent != primal && takeHolders.insert(parent).second;
         parent = parent->getParentOp())
      ;
}

/// Decides for each storage that the adjoint reads which state holds what it
/// needs, or refuses.
LogicalResult AdjointBuilder::chooseStates() {
  // Storages in the order of the program.
  llvm::MapVector<const void *, SmallVector<DifferentiableAccessInterface>>
      byStorage;
  for (auto &[storage, list] : accesses.getStorages())
    for (DifferentiableAccessInterface access : list)
      if (needed.contains(access) || plan.recorded.contains(access))
        byStorage[storage].push_back(access);
  SmallVector<Attribute> before;
  llvm::SmallDenseSet<const void *> chosen;
  for (Operation *op : wantsBefore)
    if (chosen.insert(getStorageKey(op)).second)
      before.push_back(
          cast<DifferentiableAccessInterface>(op).getAccessedStorage().field);
  for (auto &[storage, reads] : byStorage)
    if (!chosen.contains(storage) && failed(chooseState(reads, before)))
      hasErrors = true;
  if (hasErrors)
    return failure();
  if (!before.empty())
    adjoint->setAttr(kBeforeAttrName, getArrayAttr(before));
  if (!plan.storages.empty())
    adjoint->setAttr(kRerunsAttrName, getUnitAttr());
  return success();
}

/// The same for the reads of one storage.
LogicalResult
AdjointBuilder::chooseState(ArrayRef<DifferentiableAccessInterface> reads,
                            SmallVectorImpl<Attribute> &before) {
  DifferentiableAccessInterface lost, write;
  for (DifferentiableAccessInterface read : reads)
    if ((write = accesses.findLaterWrite(read))) {
      lost = read;
      break;
    }
  if (!lost)
    return success();
  FlatSymbolRefAttr field = lost.getAccessedStorage().field;
  if (plan.storages.contains(getStorageKey(lost)) && planRerun(lost, reads)) {
    // The rerun starts from what was there before.
    before.push_back(field);
    return success();
  }
  // A tape can bring back a field, and nobody an array.
  bool canRestore = field && isa<KernelOp>(primal.getOperation());
  DifferentiableAccessInterface changed, earlier;
  for (DifferentiableAccessInterface read : reads)
    if (canRestore && (earlier = accesses.findEarlierWrite(read))) {
      changed = read;
      break;
    }
  if (canRestore && !changed) {
    before.push_back(field);
    return success();
  }
  if (canRestore && planRerun(lost, reads))
    return success();
  wantsParts |= canRestore;
  InFlightDiagnostic diag =
      emitError(lost, "the value read here is needed by the gradient, but is "
                      "overwritten");
  diag.attachNote(write->getLoc()) << "overwritten here";
  if (changed) {
    if (changed != lost)
      diag.attachNote(changed->getLoc())
          << "the gradient also needs the value read here";
    diag.attachNote(earlier->getLoc())
        << "and what stood there before is replaced here";
  }
  diag.attachNote() << "store the new value to another element, such as one "
                       "more time step of the field";
  return diag;
}

/// Extends the plan by running again what reads and writes the storage of
/// `lost`. False if that does not happen in one place: in one iteration of a
/// parallel loop that runs once, or in serial code.
bool AdjointBuilder::planRerun(DifferentiableAccessInterface lost,
                               ArrayRef<DifferentiableAccessInterface> reads) {
  Block *unit = getRerunUnit(lost);
  for (Operation *parent = unit->getParentOp(); parent != primal;
       parent = parent->getParentOp())
    if (isSerialLoop(parent))
      return false;
  const void *storage = getStorageKey(lost);
  for (DifferentiableAccessInterface access :
       accesses.getStorages().find(storage)->second)
    if (access.getAccessKind() != AccessKind::Read &&
        getRerunUnit(access) != unit)
      return false;
  for (DifferentiableAccessInterface read : reads) {
    bool isOverwritten = static_cast<bool>(accesses.findLaterWrite(read));
    if (getRerunUnit(read) != unit) {
      if (isOverwritten || accesses.findEarlierWrite(read))
        return false;
    } else if (isOverwritten) {
      // Stacks cannot be handed to another function, which the body becomes.
      if (read->getParentOfType<ParallelForOp>() &&
          unit == &primal.getFunctionBody().front())
        return false;
      wantsMore |= larger.recorded.insert(read);
    }
  }
  wantsMore |= larger.storages.insert(storage).second;
  return true;
}
