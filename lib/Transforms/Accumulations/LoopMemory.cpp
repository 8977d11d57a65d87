//===- LoopMemory.cpp - What a loop does in memory ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "LoopMemory.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Transforms/RegionUtils.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Support/BoundsMode.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

std::optional<SmallVector<scf::IfOp>> tai::getConditions(Operation *op,
                                                         LoopBox &box) {
  SmallVector<scf::IfOp> conditions;
  for (Operation *parent = op->getParentOp(); parent != box.loop;
       parent = parent->getParentOp()) {
    auto condition = dyn_cast<scf::IfOp>(parent);
    if (!condition)
      return std::nullopt;
    conditions.insert(conditions.begin(), condition);
  }
  return conditions;
}

LoopAccess LoopAccess::get(Operation *op) {
  return llvm::TypeSwitch<Operation *, LoopAccess>(op)
      .Case<LoadOp, StoreOp, AtomicOp>([](auto access) {
        return LoopAccess{access,
                          {access.getIndices(), access.getComponents()}};
      });
}

LoopMemory::LoopMemory(ParallelForOp loop) : loop(loop) {
  loop.getBody().walk([&](Operation *op) {
    if (isa<LoadOp, StoreOp, AtomicOp>(op))
      accesses[getStorageKey(op)].push_back(LoopAccess::get(op));
    else
      isKnown &= op->hasTrait<OpTrait::HasRecursiveMemoryEffects>() ||
                 isMemoryEffectFree(op);
  });
}

/// True if the two accesses never reach the same element, neither in one
/// iteration nor in two different ones.
bool LoopMemory::areApart(const LoopAccess &first, const LoopAccess &second) {
  auto [entry, isNew] = compared.try_emplace({first.op, second.op}, false);
  if (!isNew || compared.size() > kMaxComparisons)
    return entry->second;
  const ElementPlace &a = first.place, &b = second.place;
  bool differInOne = areProvablyDistinct(a.indices, b.indices) ||
                     (!a.components.empty() &&
                      areProvablyDistinct(a.components, b.components));
  return entry->second = differInOne && !mayMeet(loop, a, b);
}

bool LoopMemory::isStable(LoadOp load, const void *added,
                          const llvm::SmallPtrSetImpl<Operation *> &later,
                          bool &needsLater) {
  const void *storage = getStorageKey(load);
  LoopAccess read = LoopAccess::get(load);
  for (const LoopAccess &write : accesses[storage]) {
    if (isa<LoadOp>(write.op) ||
        (storage == added && isa<AtomicOp>(write.op)) || areApart(read, write))
      continue;
    if (!later.contains(write.op))
      return false;
    needsLater = true;
  }
  return true;
}

bool tai::canRecompute(Value value, LoopBox &box,
                       llvm::function_ref<bool(Operation *)> isStable,
                       llvm::SmallDenseSet<Operation *> &seen) {
  Operation *op = value.getDefiningOp();
  if (!op || !box.loop->isProperAncestor(op) || !seen.insert(op).second)
    return true;
  bool isAllowed = true;
  op->walk([&](Operation *inner) {
    isAllowed &= isa<LoadOp, memref::LoadOp>(inner)
                     ? isStable(inner)
                     : inner->hasTrait<OpTrait::HasRecursiveMemoryEffects>() ||
                           isMemoryEffectFree(inner);
  });
  if (!isAllowed)
    return false;
  bool operands = llvm::all_of(op->getOperands(), [&](Value operand) {
    return canRecompute(operand, box, isStable, seen);
  });
  llvm::SetVector<Value> captured;
  getUsedValuesDefinedAbove(op->getRegions(), captured);
  return operands && llvm::all_of(captured, [&](Value operand) {
           return canRecompute(operand, box, isStable, seen);
         });
}

/// True if an iteration that runs `second` has run `first` before.
static bool comesBefore(Operation *first, Operation *second) {
  return findCommonBlock(first, second) && first != second &&
         first->isBeforeInBlock(second);
}

bool LoopMemory::isMovable(StoreOp store, LoopBox &box) {
  Attribute value, other;
  std::optional<SmallVector<scf::IfOp>> conditions = getConditions(store, box);
  if (!matchPattern(store.getValue(), m_Constant(&value)) || !conditions)
    return false;
  // The loop to which the store moves recomputes its operands and conditions,
  // so the memory that they load must be unchanged then.
  auto isUntouched = [&](Operation *load) {
    return isa<LoadOp>(load) && llvm::all_of(accesses[getStorageKey(load)],
                                             [](const LoopAccess &access) {
                                               return isa<LoadOp>(access.op);
                                             });
  };
  llvm::SmallDenseSet<Operation *> seen;
  auto canRepeat = [&](Value operand) {
    return canRecompute(operand, box, isUntouched, seen);
  };
  if (!llvm::all_of(store->getOperands(), canRepeat) ||
      !llvm::all_of(*conditions, [&](scf::IfOp condition) {
        return canRepeat(condition.getCondition());
      }))
    return false;
  LoopAccess own = LoopAccess::get(store);
  return llvm::all_of(
      accesses[getStorageKey(store)], [&](const LoopAccess &access) {
        auto stored = dyn_cast<StoreOp>(access.op);
        if (stored && matchPattern(stored.getValue(), m_Constant(&other)) &&
            other == value)
          return true;
        // A read that precedes the store in its iteration is not affected.
        bool isEarlier =
            isa<LoadOp>(access.op) && comesBefore(access.op, store);
        return isEarlier ? !mayMeet(loop, access.place, own.place)
                         : areApart(access, own);
      });
}

llvm::SmallPtrSet<Operation *, 4> LoopMemory::findMovableStores(LoopBox &box) {
  llvm::SmallPtrSet<Operation *, 4> movable;
  if (isKnown)
    loop.getBody().walk([&](StoreOp store) {
      if (isMovable(store, box))
        movable.insert(store);
    });
  return movable;
}

/// True if `access` reaches the same element as `own` in one iteration, false
/// if a different one; nullopt if neither is certain.
static std::optional<bool> isSameElement(const LoopAccess &own,
                                         const LoopAccess &access) {
  const ElementPlace &a = own.place, &b = access.place;
  if (areProvablyEqual(a.indices, b.indices) &&
      areProvablyEqual(a.components, b.components))
    return true;
  if (areProvablyDistinct(a.indices, b.indices) ||
      (!a.components.empty() &&
       areProvablyDistinct(a.components, b.components)))
    return false;
  return std::nullopt;
}

void tai::forwardAddition(AtomicOp addition) {
  if (!addition.getExclusive() || addition.getKind() != AtomicKind::Add ||
      !addition.getOld().use_empty() ||
      !isa<FloatType>(getElementTypeOrSelf(addition.getValue().getType())))
    return;
  const void *storage = getStorageKey(addition);
  LoopAccess own = LoopAccess::get(addition);
  SmallVector<LoadOp> loads;
  StoreOp overwrites;
  for (Operation *op = addition->getNextNode(); op && !overwrites;
       op = op->getNextNode()) {
    WalkResult result = op->walk([&](Operation *inner) {
      if (!isa<LoadOp, StoreOp, AtomicOp>(inner) ||
          getStorageKey(inner) != storage)
        return WalkResult::advance();
      std::optional<bool> isSame = isSameElement(own, LoopAccess::get(inner));
      if (isSame && !*isSame)
        return WalkResult::advance();
      if (!isSame || inner != op || isa<AtomicOp>(inner))
        return WalkResult::interrupt();
      if (auto load = dyn_cast<LoadOp>(inner))
        loads.push_back(load);
      else
        overwrites = cast<StoreOp>(inner);
      return WalkResult::advance();
    });
    if (result.wasInterrupted())
      return;
  }
  if (!overwrites)
    return;
  OpBuilder builder(addition);
  Location loc = addition.getLoc();
  auto before = LoadOp::create(builder, loc, addition.getValue().getType(),
                               addition.getFieldAttr(), addition.getIndices(),
                               addition.getComponents());
  if (addition->hasAttr(kInRangeAttrName))
    before->setAttr(kInRangeAttrName, builder.getUnitAttr());
  Value after =
      arith::AddFOp::create(builder, loc, before, addition.getValue());
  for (LoadOp load : loads) {
    load.getResult().replaceAllUsesWith(after);
    load.erase();
  }
  addition.erase();
}
