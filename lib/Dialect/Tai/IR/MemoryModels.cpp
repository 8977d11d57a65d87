//===- MemoryModels.cpp - Locals and launches in upstream's passes --------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Lets upstream's mem2reg turn a local into values, and tells passes what
// memory a launch may touch.
//
//===----------------------------------------------------------------------===//

#include "OpModels.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/IR/Builders.h"
#include "mlir/Interfaces/MemorySlotInterfaces.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// A local is one slot, which holds zero at first.
struct AllocaModel
    : PromotableAllocationOpInterface::ExternalModel<AllocaModel, AllocaOp> {
  SmallVector<MemorySlot> getPromotableSlots(Operation *op) const {
    Value local = op->getResult(0);
    return {{local, cast<LocalType>(local.getType()).getElementType()}};
  }

  Value getDefaultValue(Operation *op, const MemorySlot &slot,
                        OpBuilder &builder) const {
    return arith::ConstantOp::create(builder, op->getLoc(),
                                     builder.getZeroAttr(slot.elemType));
  }

  void handleBlockArgument(Operation *, const MemorySlot &, BlockArgument,
                           OpBuilder &) const {}

  std::optional<PromotableAllocationOpInterface>
  handlePromotionComplete(Operation *op, const MemorySlot &, Value defaultValue,
                          OpBuilder &) const {
    if (defaultValue && defaultValue.use_empty())
      defaultValue.getDefiningOp()->erase();
    op->erase();
    return std::nullopt;
  }
};

/// The model, for mem2reg, of loads and stores of a whole local variable.
template <typename Model, typename Op>
struct AccessModel : PromotableMemOpInterface::ExternalModel<Model, Op> {
  bool loadsFrom(Operation *op, const MemorySlot &slot) const {
    return isa<LocalLoadOp>(op) && cast<Op>(op).getLocal() == slot.ptr;
  }

  bool storesTo(Operation *op, const MemorySlot &slot) const {
    return isa<LocalStoreOp>(op) && cast<Op>(op).getLocal() == slot.ptr;
  }

  Value getStored(Operation *op, const MemorySlot &, OpBuilder &, Value,
                  const DataLayout &) const {
    return cast<LocalStoreOp>(op).getValue();
  }

  bool canUsesBeRemoved(Operation *op, const MemorySlot &slot,
                        const SmallPtrSetImpl<OpOperand *> &blockingUses,
                        SmallVectorImpl<OpOperand *> &,
                        const DataLayout &) const {
    auto access = cast<Op>(op);
    return blockingUses.size() == 1 &&
           *blockingUses.begin() == &access.getLocalMutable() &&
           access.getValue().getType() == slot.elemType;
  }

  DeletionKind removeBlockingUses(Operation *op, const MemorySlot &,
                                  const SmallPtrSetImpl<OpOperand *> &,
                                  OpBuilder &, Value reachingDefinition,
                                  const DataLayout &) const {
    if (auto load = dyn_cast<LocalLoadOp>(op))
      load.getValue().replaceAllUsesWith(reachingDefinition);
    return DeletionKind::Delete;
  }
};
struct LoadModel : AccessModel<LoadModel, LocalLoadOp> {};
struct StoreModel : AccessModel<StoreModel, LocalStoreOp> {};

/// A launch reads and writes any field and array, and allocates nothing. The
/// effects do not depend on the body of the kernel, which other threads may
/// change while a pass looks at the launch.
struct LaunchModel
    : MemoryEffectOpInterface::ExternalModel<LaunchModel, LaunchOp> {
  void
  getEffects(Operation *,
             SmallVectorImpl<MemoryEffects::EffectInstance> &effects) const {
    for (MemoryEffects::Effect *effect :
         {static_cast<MemoryEffects::Effect *>(MemoryEffects::Read::get()),
          static_cast<MemoryEffects::Effect *>(MemoryEffects::Write::get())}) {
      effects.emplace_back(effect, SideEffects::DefaultResource::get());
      effects.emplace_back(effect, FieldResource::get());
    }
  }
};
} // namespace

void tai::attachMemoryModels(MLIRContext &context) {
  AllocaOp::attachInterface<AllocaModel>(context);
  LocalLoadOp::attachInterface<LoadModel>(context);
  LocalStoreOp::attachInterface<StoreModel>(context);
  LaunchOp::attachInterface<LaunchModel>(context);
}
