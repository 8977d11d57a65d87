//===- IndexedAccess.cpp - Indices of an access ---------------------------===//
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

std::string tai::describeElement(FieldOp field) {
  std::string text;
  llvm::raw_string_ostream os(text);
  os << "an element of shape [";
  llvm::interleaveComma(cast<VectorType>(field.getType()).getShape(), os);
  os << "] of field '@" << field.getSymName() << "'";
  return text;
}

std::string tai::describeArray(MemRefType type) {
  std::string text;
  llvm::raw_string_ostream os(text);
  os << "an array of " << type.getElementType() << " of shape [";
  llvm::interleaveComma(type.getShape(), os, [&](int64_t extent) {
    if (ShapedType::isDynamic(extent))
      os << "{}";
    else
      os << extent;
  });
  os << "]";
  return text;
}

/// Returns the dimension of a field along which the innermost list above it
/// grows. Ops on lists have no index for this dimension.
static size_t findListDimension(const FieldLayout &layout) {
  for (const PathLevel &level : llvm::reverse(layout.path.levels))
    if (level.type.isList())
      for (auto [dimension, axis] : llvm::enumerate(layout.axisOfIndex))
        if (llvm::is_contained(level.type.getAxes(), axis))
          return dimension;
  llvm_unreachable("the field is below no list");
}

/// Adds the operands to the access by pointers, so that a client can replace
/// them.
static void addOperands(IndexedAccess &access, OperandRange operands) {
  for (unsigned i = 0; i != operands.size(); ++i)
    access.indices.push_back(&operands.getBase()[i]);
}

static IndexedAccess getFieldAccess(FieldAccessOpInterface op) {
  FieldOp field = lookupField(op, op.getFieldAttr());
  FieldLayout layout = *getFieldLayout(field);
  IndexedAccess access{op, describeField(layout), {}, {}, {}};
  addOperands(access, op.getIndices());
  access.rank = access.indices.size();
  size_t numDimensions = layout.shape.size();
  size_t left =
      access.rank < numDimensions ? findListDimension(layout) : numDimensions;
  for (size_t d = 0; d != numDimensions; ++d) {
    if (d == left)
      continue;
    access.first.push_back(layout.offset[d]);
    access.extents.push_back({layout.shape[d]});
  }
  assert(access.rank == access.extents.size() && "the verifier counts indices");
  auto type = dyn_cast<VectorType>(field.getType());
  if (OperandRange components = op.getComponents();
      type && !components.empty()) {
    addOperands(access, components);
    for (int64_t extent : type.getShape()) {
      access.first.push_back(0);
      access.extents.push_back({extent});
    }
  }
  return access;
}

static std::optional<IndexedAccess>
getArrayAccess(Operation *op, Value array, MutableOperandRange indices) {
  auto type = cast<MemRefType>(array.getType());
  // An array that is no argument is memory of the kernel.
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
  return llvm::TypeSwitch<Operation *, std::optional<IndexedAccess>>(op)
      .Case(
          [](FieldAccessOpInterface access) { return getFieldAccess(access); })
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
