//===- IterationOrder.cpp - Do iterations depend on order -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Compares all accesses of a loop to one storage. Arrays of the caller may be
// identical: arrays with the same type of elements count as one storage, unless
// the loop says that they are apart.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/IterationOrder.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/Accesses.h"
#include "llvm/ADT/MapVector.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
enum class Effect { Read, Write, Update };

/// An access of one iteration to an element.
struct ElementAccess {
  ElementPlace place;
  Effect effect = Effect::Read;
  /// The value that a write stores.
  Value stored;
  /// The kind of an update: updates of the same kind commute. Subtractions
  /// count as additions.
  AtomicKind kind = AtomicKind::Add;
  bool usesOld = false;
};
} // namespace

static AtomicKind toFamily(AtomicKind kind) {
  return kind == AtomicKind::Sub ? AtomicKind::Add : kind;
}

static bool isFromOutside(ParallelForOp loop, Value value) {
  return !loop->isAncestor(value.getParentBlock()->getParentOp());
}

/// True if the writes `a` and `b` store the same value, whichever iterations
/// they are in.
static bool storeEqual(ParallelForOp loop, const ElementAccess &a,
                       const ElementAccess &b) {
  if (a.effect != Effect::Write || b.effect != Effect::Write)
    return false;
  Attribute x, y;
  if (matchPattern(a.stored, m_Constant(&x)) &&
      matchPattern(b.stored, m_Constant(&y)))
    return x == y;
  return a.stored == b.stored && isFromOutside(loop, a.stored);
}

static bool commute(ParallelForOp loop, const ElementAccess &a,
                    const ElementAccess &b) {
  if (a.effect == Effect::Read && b.effect == Effect::Read)
    return true;
  if (a.effect == Effect::Update && b.effect == Effect::Update)
    return a.kind == b.kind && !a.usesOld && !b.usesOld;
  return storeEqual(loop, a, b);
}

using KeyedAccess = std::pair<const void *, ElementAccess>;

/// Describes the access that `op` makes, and the key of its storage; a null key
/// if `op` accesses no memory that iterations share. Fails for unsupported ops.
static FailureOr<KeyedAccess> getAccess(ParallelForOp loop, Operation *op) {
  ElementAccess access;
  KeyedAccess none(nullptr, access);
  if (auto field = dyn_cast<FieldAccessOpInterface>(op)) {
    // Ops that change or test the activity of cells are atomic by themselves,
    // and need no order.
    if (!field.isElementAccess())
      return none;
    access.place.indices = field.getIndices();
    if (auto load = dyn_cast<LoadOp>(op)) {
      access.place.components = load.getComponents();
    } else if (auto store = dyn_cast<StoreOp>(op)) {
      access.place.components = store.getComponents();
      access.effect = Effect::Write;
      access.stored = store.getValue();
    } else {
      auto atomic = dyn_cast<AtomicOp>(op);
      if (!atomic)
        return failure();
      access.place.components = atomic.getComponents();
      access.effect = Effect::Update;
      access.kind = toFamily(atomic.getKind());
      access.usesOld = !atomic.getOld().use_empty();
    }
    return KeyedAccess(getStorageKey(op), access);
  }
  Value array;
  if (auto load = dyn_cast<memref::LoadOp>(op)) {
    array = load.getMemRef();
    access.place.indices = load.getIndices();
  } else if (auto store = dyn_cast<memref::StoreOp>(op)) {
    array = store.getMemRef();
    access.place.indices = store.getIndices();
    access.effect = Effect::Write;
    access.stored = store.getValueToStore();
  } else if (auto atomic = dyn_cast<memref::AtomicRMWOp>(op)) {
    array = atomic.getMemref();
    access.place.indices = atomic.getIndices();
    access.effect = Effect::Update;
    access.usesOld = !atomic.getResult().use_empty();
    switch (atomic.getKind()) {
    case arith::AtomicRMWKind::addf:
    case arith::AtomicRMWKind::addi:
      break;
    case arith::AtomicRMWKind::mulf:
    case arith::AtomicRMWKind::muli:
      access.kind = AtomicKind::Mul;
      break;
    case arith::AtomicRMWKind::maximumf:
    case arith::AtomicRMWKind::maxnumf:
    case arith::AtomicRMWKind::maxs:
      access.kind = AtomicKind::Max;
      break;
    case arith::AtomicRMWKind::minimumf:
    case arith::AtomicRMWKind::minnumf:
    case arith::AtomicRMWKind::mins:
      access.kind = AtomicKind::Min;
      break;
    default:
      access.usesOld = true;
    }
  }
  if (array) {
    if (!isFromOutside(loop, array))
      return none;
    if (loop->hasAttr(kApartAttrName) ||
        isa_and_present<memref::AllocOp, memref::AllocaOp>(
            array.getDefiningOp()))
      return KeyedAccess(array.getAsOpaquePointer(), access);
    Type element = cast<MemRefType>(array.getType()).getElementType();
    return KeyedAccess(element.getAsOpaquePointer(), access);
  }
  if (auto load = dyn_cast<LocalLoadOp>(op)) {
    if (!isFromOutside(loop, load.getLocal()))
      return none;
    return KeyedAccess(load.getLocal().getAsOpaquePointer(), access);
  }
  if (auto store = dyn_cast<LocalStoreOp>(op)) {
    if (!isFromOutside(loop, store.getLocal()))
      return none;
    access.effect = Effect::Write;
    access.stored = store.getValue();
    return KeyedAccess(store.getLocal().getAsOpaquePointer(), access);
  }
  if (op->hasTrait<OpTrait::HasRecursiveMemoryEffects>() ||
      isMemoryEffectFree(op) || isa_and_present<TaiDialect>(op->getDialect()) ||
      isa<memref::AllocOp, memref::AllocaOp, memref::DeallocOp>(op))
    return none;
  return failure();
}

bool mlir::tai::dependsOnOrder(ParallelForOp loop) {
  llvm::MapVector<const void *, SmallVector<ElementAccess>> storages;
  WalkResult result = loop.getBody().walk([&](Operation *op) {
    auto found = getAccess(loop, op);
    if (failed(found))
      return WalkResult::interrupt();
    if (found->first)
      storages[found->first].push_back(found->second);
    return WalkResult::advance();
  });
  if (result.wasInterrupted())
    return true;
  for (auto &[storage, accesses] : storages)
    for (size_t i = 0; i != accesses.size(); ++i)
      for (size_t j = i; j != accesses.size(); ++j)
        if (!commute(loop, accesses[i], accesses[j]) &&
            mayMeet(loop, accesses[i].place, accesses[j].place))
          return true;
  return false;
}
