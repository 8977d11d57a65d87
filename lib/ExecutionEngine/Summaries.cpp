//===- Summaries.cpp - What the runtime knows of a kernel -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The slots of arguments, and the summary that the tape works from.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Accesses.h"
#include "tai/ExecutionEngine/AdjointNeeds.h"
#include "tai/ExecutionEngine/Session.h"

using namespace mlir;
using namespace mlir::tai;

/// Slots of a value of the type; see Abi.h.
static int64_t countSlots(Type type) {
  if (auto vector = dyn_cast<VectorType>(type))
    return vector.getNumElements();
  if (auto memref = dyn_cast<MemRefType>(type))
    return 1 + memref.getRank();
  return 1;
}

int64_t mlir::tai::countSlots(TypeRange types) {
  int64_t slots = 0;
  for (Type type : types)
    slots += ::countSlots(type);
  return slots;
}

/// The arguments of kernels that are whole numbers, and their slots.
static DenseMap<Value, int64_t> findIntegerArguments(ModuleOp module) {
  DenseMap<Value, int64_t> slots;
  for (KernelOp kernel : module.getOps<KernelOp>()) {
    int64_t next = 0;
    for (BlockArgument argument : kernel.getArguments()) {
      if (argument.getType().isSignlessInteger() &&
          argument.getType().getIntOrFloatBitWidth() <= 64)
        slots[argument] = next;
      next += ::countSlots(argument.getType());
    }
  }
  return slots;
}

/// The first index that is a sum of constants and integer arguments.
static std::optional<runtime::FixedIndex>
getFixedIndex(ValueRange indices, const DenseMap<Value, int64_t> &slots) {
  for (auto [dimension, index] : llvm::enumerate(indices)) {
    LinearIndex form = getLinearIndex(index);
    runtime::FixedIndex fixed{
        static_cast<int64_t>(dimension), form.constant, {}};
    for (auto [term, factor] : form.terms) {
      auto slot = slots.find(term);
      if (slot == slots.end())
        break;
      fixed.terms.push_back(
          {slot->second, term.getType().getIntOrFloatBitWidth(), factor});
    }
    if (fixed.terms.size() == form.terms.size() && !form.mayWrap)
      return fixed;
  }
  return std::nullopt;
}

std::vector<NamedAccess> mlir::tai::listAccesses(Operation *root) {
  using Kind = runtime::AccessKind;
  auto module = root->getParentOfType<ModuleOp>();
  DenseMap<Value, int64_t> slots =
      findIntegerArguments(module ? module : cast<ModuleOp>(root));
  std::vector<NamedAccess> list;
  auto add = [&](FlatSymbolRefAttr field, Kind kind, ValueRange indices = {}) {
    NamedAccess access{field.getValue().str(), kind,
                       getFixedIndex(indices, slots)};
    if (!llvm::is_contained(list, access))
      list.push_back(std::move(access));
  };
  root->walk([&](Operation *op) {
    auto field = op->getAttrOfType<FlatSymbolRefAttr>("field");
    if (!field || isa<ParallelForOp>(op))
      return;
    if (auto load = dyn_cast<LoadOp>(op))
      return add(field, Kind::Read, load.getIndices());
    if (isa<IsActiveOp, LengthOp>(op))
      return add(field, Kind::Read);
    if (auto store = dyn_cast<StoreOp>(op))
      return add(field, Kind::Write, store.getIndices());
    if (isa<ActivateOp, DeactivateOp>(op))
      return add(field, Kind::Write);
    if (auto atomic = dyn_cast<AtomicOp>(op)) {
      bool isSum = atomic.getKind() == AtomicKind::Add ||
                   atomic.getKind() == AtomicKind::Sub;
      if (!isSum || !atomic.getOld().use_empty())
        add(field, Kind::Read, atomic.getIndices());
      return add(field, isSum ? Kind::Accumulate : Kind::Write,
                 atomic.getIndices());
    }
    // Whatever else touches a field may do anything to it.
    add(field, Kind::Read);
    add(field, Kind::Write);
  });
  return list;
}

std::vector<runtime::Access> Session::summarize(ModuleOp module,
                                                KernelOp kernel) {
  std::vector<runtime::Access> summary;
  for (Operation &op : *module.getBody()) {
    // The adjoint that a kernel may come with is not part of it.
    if (isa<KernelOp>(op) && &op != kernel)
      continue;
    for (NamedAccess &access : listAccesses(&op)) {
      runtime::FieldPtr field = rt->findField(access.field);
      if (!field)
        continue;
      runtime::Access line{field, access.kind, std::move(access.fixed)};
      if (!llvm::is_contained(summary, line))
        summary.push_back(std::move(line));
    }
    // All that lies below a cell becomes zero, whichever field names it.
    op.walk([&](DeactivateOp deactivate) {
      runtime::FieldPtr named = rt->findField(deactivate.getField().str());
      for (const runtime::FieldPtr &field : rt->fields()) {
        if (!named || &field->tree() != &named->tree() ||
            !field->sparseNode() || field->isAdjoint())
          continue;
        runtime::Access line{field, runtime::AccessKind::Write, {}};
        if (!llvm::is_contained(summary, line))
          summary.push_back(std::move(line));
      }
    });
  }
  return summary;
}
