//===- FieldTable.cpp - Fields and their places in memory -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/FieldTable.h"

using namespace mlir;
using namespace mlir::tai;

FieldTable::FieldTable(Operation *root)
    : symbols(root), dataLayout(DataLayout::closest(root)),
      domain(LLVM::AliasScopeDomainAttr::get(
          root->getContext(), StringAttr::get(root->getContext(), "tai"),
          StringAttr())) {}

LLVM::AliasScopeAttr FieldTable::makeScope(StringRef id) {
  MLIRContext *context = domain.getContext();
  return LLVM::AliasScopeAttr::get(context, StringAttr::get(context, id),
                                   domain, StringAttr());
}

FailureOr<const FieldInfo *> FieldTable::lookup(Operation *user,
                                                FlatSymbolRefAttr name) {
  // The op may be in a nested module, in which the name can stand for another
  // field.
  if (SymbolTable::getNearestSymbolTable(user) != symbols.getOp())
    return user->emitOpError("stands in a nested module, whose fields are not "
                             "lowered with those outside");
  std::unique_ptr<FieldInfo> &slot = fields[name.getAttr()];
  if (slot)
    return const_cast<const FieldInfo *>(slot.get());

  auto field = symbols.lookup<FieldOp>(name.getAttr());
  if (!field)
    return user->emitOpError("names ") << name << ", which is not a field";
  FailureOr<FieldLayout> layout = getFieldLayout(field);
  if (failed(layout))
    return user->emitOpError("names the field ")
           << name << ", which has no place in a tree";
  auto info = std::make_unique<FieldInfo>();
  info->layout = *layout;
  info->storage = getFieldStorage(info->layout, dataLayout);
  if (!info->storage.sparse.empty()) {
    SmallVector<SparseNode> nodes =
        getSparseNodes(layout->tree.getLayout(), dataLayout);
    for (auto [level, number] : info->storage.sparse) {
      const SparseNode &node = nodes[number];
      info->sparse.push_back({node.type, level, number, node.activityOffset,
                              node.type.getNumCells()});
    }
  }
  const PlacePath &path = layout->path;
  if (!path.levels.empty())
    info->cellOffset = getChildOffset(path.levels.back().type.getChildren(),
                                      path.placesChild, dataLayout) +
                       getPlaceOffset(path.places, path.place, dataLayout);
  Type type = path.getElementType();
  info->scalarType = getElementTypeOrSelf(type);
  info->scalarSize = getValueSize(info->scalarType, dataLayout);
  info->numComponents = 1;
  if (auto vector = dyn_cast<VectorType>(type)) {
    info->elementShape.assign(vector.getShape().begin(),
                              vector.getShape().end());
    info->numComponents = vector.getNumElements();
  }
  std::string id = (layout->tree.getSymName() + "." + field.getPlace()).str();
  info->scope = makeScope(id);
  if (!llvm::is_contained(scopes, info->scope)) {
    scopes.push_back(info->scope);
    otherScopes.clear();
  }
  slot = std::move(info);
  return const_cast<const FieldInfo *>(slot.get());
}

AliasScopes FieldTable::getScopes(LLVM::AliasScopeAttr scope) {
  MLIRContext *context = domain.getContext();
  ArrayAttr &others = otherScopes[scope];
  if (!others) {
    SmallVector<Attribute> list;
    for (LLVM::AliasScopeAttr other : scopes)
      if (other != scope)
        list.push_back(other);
    others = ArrayAttr::get(context, list);
  }
  return {ArrayAttr::get(context, {scope}), others.empty() ? nullptr : others,
          nullptr};
}

AliasScopes FieldTable::getScopes(const FieldInfo &field) {
  return getScopes(field.scope);
}

AliasScopes FieldTable::getArrayScopes() {
  return getScopes(makeScope("arrays"));
}

std::optional<FieldSlice> FieldTable::getSlice(const FieldInfo &field,
                                               ArrayRef<bool> fixed) {
  ArrayRef<IndexDigit> digits = field.storage.digits;
  // The digits of the field (parts of its indices, one for each level) are
  // sorted by ascending stride. Digits of extent 1 are omitted, because they
  // add nothing to an address.
  SmallVector<unsigned> order;
  for (unsigned i = 0; i != digits.size(); ++i)
    if (digits[i].extent != 1)
      order.push_back(i);
  llvm::sort(order, [&](unsigned a, unsigned b) {
    return std::pair(digits[a].stride, a) < std::pair(digits[b].stride, b);
  });

  // A fixed dimension stays fixed if all its digits are outside the digits of
  // all free dimensions. Freeing a dimension can only free others, so that
  // repeating the scan from the inside until nothing changes terminates.
  FieldSlice slice;
  slice.fixed.assign(fixed.begin(), fixed.end());
  for (bool changed = true; changed;) {
    changed = false;
    bool freeOutside = false;
    for (unsigned i : llvm::reverse(order)) {
      bool isFixed = slice.fixed[digits[i].dimension];
      if (isFixed && freeOutside) {
        slice.fixed[digits[i].dimension] = false;
        changed = true;
      }
      freeOutside |= !isFixed;
    }
  }

  slice.digitCells.assign(digits.size(), 0);
  slice.cellStride = field.numComponents * field.scalarSize;
  slice.numCells = 1;
  bool first = true;
  for (unsigned i : order) {
    if (slice.fixed[digits[i].dimension])
      continue;
    int64_t stride = digits[i].stride;
    if (first)
      slice.cellStride = stride;
    first = false;
    if (stride != slice.cellStride * slice.numCells)
      return std::nullopt;
    slice.digitCells[i] = slice.numCells;
    slice.numCells *= digits[i].extent;
  }
  return slice;
}
