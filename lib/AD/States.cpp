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
#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

/// Finds the stores that take the adjoints of their elements: those of elements
/// that an earlier access of the kernel may have used, for its reverse must not
/// see the adjoint of the stored value.
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
      if (takesAll || llvm::any_of(active, [&](auto access) {
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
  llvm::MapVector<const void *, SmallVector<DifferentiableAccessInterface>>
      byStorage;
  for (Operation *read : needed)
    byStorage[getStorageKey(read)].push_back(
        cast<DifferentiableAccessInterface>(read));
  SmallVector<Attribute> before;
  for (auto &[storage, reads] : byStorage) {
    DifferentiableAccessInterface lost, write;
    for (DifferentiableAccessInterface read : reads)
      if ((write = accesses.findLaterWrite(read))) {
        lost = read;
        break;
      }
    if (!lost)
      continue;
    // A tape can bring back a field, and nobody an array.
    FlatSymbolRefAttr field = lost.getAccessedStorage().field;
    bool canRestore = field && isa<KernelOp>(primal.getOperation());
    DifferentiableAccessInterface changed, earlier;
    for (DifferentiableAccessInterface read : reads)
      if (canRestore && (earlier = accesses.findEarlierWrite(read))) {
        changed = read;
        break;
      }
    if (canRestore && !changed) {
      before.push_back(field);
      continue;
    }
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
  }
  if (hasErrors)
    return failure();
  if (!before.empty())
    adjoint->setAttr(kBeforeAttrName, getArrayAttr(before));
  return success();
}
