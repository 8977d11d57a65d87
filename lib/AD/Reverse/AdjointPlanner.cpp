//===- AdjointPlanner.cpp - Plans reverse mode of a kernel ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Reverse/AdjointPlanner.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/SkipScope.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

FailureOr<bool> AdjointPlanner::settle(const PrimalDemands &demands) {
  larger = plan.reexecution;
  hasGrown = wantsParts = false;
  before.clear();
  for (Operation *draw : demands.draws)
    hasGrown |= larger.addRecorded(draw);
  // Reads are grouped by storage, with storages in program order.
  llvm::MapVector<const void *, SmallVector<DifferentiableAccessInterface>>
      byStorage;
  for (auto &[storage, list] : plan.accesses.getStorages())
    for (DifferentiableAccessInterface access : list)
      if (demands.reads.contains(access) ||
          plan.reexecution.isRecorded(access.getOperation()))
        byStorage[storage].push_back(access);
  llvm::SmallDenseSet<const void *> chosen;
  for (Operation *op : demands.before)
    if (chosen.insert(getStorageKey(op)).second)
      before.push_back(
          cast<DifferentiableAccessInterface>(op).getAccessedStorage().field);
  bool allChosen = true;
  for (auto &[storage, reads] : byStorage)
    if (chooseRecorded(reads))
      allChosen = false;
    else if (failed(chosen.contains(storage) ? checkBefore(reads, demands)
                                             : chooseVersion(reads)))
      allChosen = false;
  if (!allChosen)
    return failure();
  if (hasGrown)
    plan.reexecution = larger;
  return !hasGrown;
}

void AdjointPlanner::annotate(FunctionOpInterface adjoint) const {
  Builder builder(adjoint.getContext());
  if (!before.empty())
    adjoint->setAttr(getFunctionAttrName(adjoint, "reads_before"),
                     builder.getArrayAttr(before));
  if (plan.reexecution.hasRewritten())
    adjoint->setAttr(getFunctionAttrName(adjoint, "reexecutes"),
                     builder.getUnitAttr());
}

bool AdjointPlanner::findsStored(ArrayRef<Operation *> stores) const {
  if (stores.empty() || plan.reexecution.hasRecorded() ||
      plan.reexecution.hasRewritten())
    return false;
  return llvm::none_of(stores, [&](Operation *store) {
    return llvm::any_of(before, [&](Attribute name) {
      FieldOp field = lookupField(store, cast<FlatSymbolRefAttr>(name));
      return getFieldStorageKey(field) == getStorageKey(store);
    });
  });
}

/// Requests a record of `reads` if their values are no longer in memory when
/// the adjoint runs. Returns true if a record was requested.
bool AdjointPlanner::chooseRecorded(
    ArrayRef<DifferentiableAccessInterface> reads) {
  if (!plan.local.toRecord)
    return false;
  DifferentiableAccessInterface first = reads.front();
  Value array = first.getAccessedStorage().memref;
  bool isWanted =
      array &&
      (plan.isOwnArray(array) || llvm::any_of(reads, [&](auto read) {
         return static_cast<bool>(plan.accesses.findLaterWrite(read)) ||
                (plan.local.recordsAll && plan.accesses.findEarlierWrite(read));
       }));
  if (isWanted)
    for (DifferentiableAccessInterface read : reads)
      plan.local.toRecord->insert(read);
  return isWanted;
}

/// Refuses reads of values that this launch wrote, in a storage of which other
/// operations need the version before the launch.
LogicalResult
AdjointPlanner::checkBefore(ArrayRef<DifferentiableAccessInterface> reads,
                            const PrimalDemands &demands) {
  for (DifferentiableAccessInterface read : reads) {
    if (demands.before.contains(read.getOperation()))
      continue;
    DifferentiableAccessInterface earlier =
        plan.accesses.findEarlierWrite(read);
    if (!earlier)
      continue;
    wantsParts = true;
    InFlightDiagnostic diag =
        read.emitError("the value read here is needed by the gradient, and "
                       "another update of the field needs what stood there "
                       "before the kernel");
    diag.attachNote(earlier->getLoc()) << "the value is written here";
    diag.attachNote() << "put the update into a kernel of its own";
    return failure();
  }
  return success();
}

/// Decides whether the version of a storage before or after the kernel holds
/// the values of these reads. Emits an error and fails if neither can be used.
LogicalResult
AdjointPlanner::chooseVersion(ArrayRef<DifferentiableAccessInterface> reads) {
  DifferentiableAccessInterface lost, write;
  for (DifferentiableAccessInterface read : reads)
    if ((write = plan.accesses.findLaterWrite(read))) {
      lost = read;
      break;
    }
  if (!lost)
    return success();
  FlatSymbolRefAttr field = lost.getAccessedStorage().field;
  if (plan.reexecution.isRewritten(getStorageKey(lost)) &&
      planReexecution(lost, reads)) {
    // The second execution starts from the contents of the field before the
    // kernel.
    before.push_back(field);
    return success();
  }
  // A tape can restore a field, but not an array.
  bool canRestore = field && isa<KernelOp>(plan.primal.getOperation());
  DifferentiableAccessInterface changed, earlier;
  for (DifferentiableAccessInterface read : reads)
    if (canRestore && (earlier = plan.accesses.findEarlierWrite(read))) {
      changed = read;
      break;
    }
  if (canRestore && !changed) {
    before.push_back(field);
    return success();
  }
  if (canRestore && planReexecution(lost, reads))
    return success();
  wantsParts |= canRestore;
  InFlightDiagnostic diag =
      lost.emitError("the value read here is needed by the gradient, but is "
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

/// Extends the plan by a second execution of the operations that read and write
/// the storage of `lost`. False if the operations are not all in one block: the
/// body of a parallel loop that runs once, or serial code.
bool AdjointPlanner::planReexecution(
    DifferentiableAccessInterface lost,
    ArrayRef<DifferentiableAccessInterface> reads) {
  Block *block = getReexecutedBlock(lost);
  for (Operation *parent = block->getParentOp(); parent != plan.primal;
       parent = parent->getParentOp())
    if (isSerialLoop(parent))
      return false;
  const void *storage = getStorageKey(lost);
  for (DifferentiableAccessInterface access :
       plan.accesses.getStorages().find(storage)->second)
    if (access.getAccessKind() != AccessKind::Read &&
        getReexecutedBlock(access) != block)
      return false;
  for (DifferentiableAccessInterface read : reads) {
    bool isOverwritten = static_cast<bool>(plan.accesses.findLaterWrite(read));
    if (getReexecutedBlock(read) != block) {
      if (isOverwritten || plan.accesses.findEarlierWrite(read))
        return false;
    } else if (isOverwritten) {
      // The body of a parallel loop becomes a function of its own, which cannot
      // use stacks that serial code creates.
      if (read->getParentOfType<ParallelForOp>() &&
          block == &plan.primal.getFunctionBody().front())
        return false;
      hasGrown |= larger.addRecorded(read);
    }
  }
  hasGrown |= larger.addStorage(storage);
  return true;
}

void mlir::tai::countSkips(const AdjointPlan &plan,
                           const PrimalDemands &demands) {
  int64_t values = 0, active = 0;
  bool anyAccess = false;
  auto count = [&](Value value) {
    if (!isFloatOrVector(value.getType()) || value.use_empty())
      return;
    ++values;
    active += plan.activity.isActive(value);
  };
  FunctionOpInterface primal = plan.primal;
  primal.walk([&](Operation *op) {
    anyAccess |= plan.activity.isActiveAccess(op);
    if (op->hasTrait<OpTrait::ConstantLike>())
      return;
    llvm::for_each(op->getResults(), count);
    for (Region &region : op->getRegions())
      for (Block &block : region)
        llvm::for_each(block.getArguments(), count);
  });
  SkipScope::count(SkipCount::ValuesAll, values);
  SkipScope::count(SkipCount::ValuesActive, active);
  SkipScope::count(SkipCount::KernelsWithoutAdjoint, anyAccess ? 0 : 1);
  SkipScope::count(SkipCount::ValuesCarried, demands.carriedValues);
  SkipScope::count(SkipCount::ValuesRecorded, demands.recordedValues);
}
