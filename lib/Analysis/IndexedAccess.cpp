//===- IndexedAccess.cpp - Accesses taken apart ---------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/IndexedAccess.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

std::string tai::describeField(const FieldLayout &layout) {
  std::string text;
  llvm::raw_string_ostream os(text);
  os << "field '@" << FieldOp(layout.field).getSymName() << "' of shape [";
  llvm::interleaveComma(layout.shape, os);
  os << "]";
  if (llvm::any_of(layout.offset, [](int64_t o) { return o != 0; })) {
    os << " from [";
    llvm::interleaveComma(layout.offset, os);
    os << "]";
  }
  return text;
}

std::string tai::describeArray(MemRefType type) {
  std::string text;
  llvm::raw_string_ostream os(text);
  os << "an array of " << type.getElementType() << " of shape [";
  llvm::interleaveComma(type.getShape(), os, [&](int64_t extent) {
    if (ShapedType::isDynamic(extent))
      os << '?';
    else
      os << extent;
  });
  os << "]";
  return text;
}

/// The index along which the innermost list above a field grows; it is not
/// among the indices of the list.
static std::optional<unsigned> findListDimension(const FieldLayout &layout) {
  for (const PathLevel &level : llvm::reverse(layout.path.levels))
    if (level.type.isList())
      for (auto [dimension, axis] : llvm::enumerate(layout.axisOfIndex))
        if (llvm::is_contained(level.type.getAxes(), axis))
          return dimension;
  return std::nullopt;
}

static std::optional<IndexedAccess> getFieldAccess(Operation *op,
                                                   FlatSymbolRefAttr name,
                                                   MutableOperandRange indices,
                                                   bool isOfList = false) {
  FieldOp field = lookupField(op, name);
  FailureOr<FieldLayout> layout =
      field ? getFieldLayout(field) : FailureOr<FieldLayout>();
  if (failed(layout))
    return std::nullopt;
  IndexedAccess access{op, describeField(*layout), {}, {}, {}};
  std::optional<unsigned> left =
      isOfList ? findListDimension(*layout) : std::nullopt;
  if (isOfList && !left)
    return std::nullopt;
  for (size_t d = 0; d != layout->shape.size(); ++d) {
    if (left && *left == d)
      continue;
    access.first.push_back(layout->offset[d]);
    access.extents.push_back({layout->shape[d]});
  }
  for (OpOperand &index : indices)
    access.indices.push_back(&index);
  access.rank = access.indices.size();
  if (access.rank != access.extents.size())
    return std::nullopt;
  return access;
}

static void addComponents(IndexedAccess &access, FieldOp field,
                          MutableOperandRange components) {
  auto type = dyn_cast<VectorType>(field.getType());
  if (!type)
    return;
  for (auto [number, component] : llvm::enumerate(components)) {
    access.indices.push_back(&component);
    access.first.push_back(0);
    access.extents.push_back({type.getDimSize(number)});
  }
}

static std::optional<IndexedAccess>
getArrayAccess(Operation *op, Value array, MutableOperandRange indices) {
  auto type = cast<MemRefType>(array.getType());
  // Others are memory of the kernel itself.
  if (!isa<BlockArgument>(array))
    return std::nullopt;
  IndexedAccess access{op, describeArray(type), {}, {}, {}};
  for (auto [d, index] : llvm::enumerate(indices)) {
    access.indices.push_back(&index);
    access.first.push_back(0);
    access.extents.push_back(type.isDynamicDim(d)
                                 ? Extent{int64_t(d), array}
                                 : Extent{type.getDimSize(d), {}});
  }
  access.rank = access.indices.size();
  return access;
}

std::optional<IndexedAccess> IndexedAccess::get(Operation *op) {
  auto ofField = [&](auto access) {
    std::optional<IndexedAccess> result =
        getFieldAccess(op, access.getFieldAttr(), access.getIndicesMutable());
    if (result)
      addComponents(*result, lookupField(op, access.getFieldAttr()),
                    access.getComponentsMutable());
    return result;
  };
  auto ofCell = [&](auto access, bool isOfList) {
    return getFieldAccess(op, access.getFieldAttr(), access.getIndicesMutable(),
                          isOfList);
  };
  return llvm::TypeSwitch<Operation *, std::optional<IndexedAccess>>(op)
      .Case<LoadOp, StoreOp, AtomicOp>(ofField)
      .Case<ActivateOp, DeactivateOp, IsActiveOp>(
          [&](auto access) { return ofCell(access, false); })
      .Case<LengthOp, AppendOp>(
          [&](auto access) { return ofCell(access, true); })
      .Case([&](memref::LoadOp load) {
        return getArrayAccess(op, load.getMemRef(), load.getIndicesMutable());
      })
      .Case([&](memref::StoreOp store) {
        return getArrayAccess(op, store.getMemRef(), store.getIndicesMutable());
      })
      .Case([&](memref::AtomicRMWOp atomic) {
        return getArrayAccess(op, atomic.getMemref(),
                              atomic.getIndicesMutable());
      })
      .Default([](Operation *) { return std::nullopt; });
}
