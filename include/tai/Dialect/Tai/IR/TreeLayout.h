//===- TreeLayout.h - Addresses of all fields of a tree ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Where a place lies depends on all that comes before it in its tree. The
// functions of Layout.h add up sizes and offsets for one place; a TreeLayout
// keeps the sums, so that all fields of a tree take time in proportion to their
// number.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TREELAYOUT_H
#define TAI_DIALECT_TAI_IR_TREELAYOUT_H

#include "mlir/IR/DialectInterface.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "llvm/ADT/DenseMap.h"
#include <mutex>

namespace mlir::tai {

/// Used by one thread at a time.
class TreeLayout {
public:
  /// The data layout outlives this object.
  TreeLayout(RootType root, const DataLayout &dataLayout)
      : root(root), dataLayout(dataLayout) {}

  /// See the functions of the same names in Layout.h.
  ArrayRef<SparseNode> getSparseNodes();
  TreeSize getTreeSize();
  FieldStorage getFieldStorage(const FieldLayout &layout);

private:
  /// Offset of child `index` in the root; getOffset: in a cell with `children`.
  uint64_t getRootOffset(unsigned index);
  uint64_t getOffset(ArrayRef<Type> children, unsigned index);
  uint64_t getOffsetOfPlace(PlacesType places, unsigned index);
  ArrayRef<uint64_t> getCellStrides(SNodeTypeInterface level);
  void findNodes(ArrayRef<Type> children, const SparseNode &above,
                 function_ref<uint64_t(unsigned)> offsetOf);
  void addSteps(SNodeTypeInterface level, SparseNode &node);

  RootType root;
  const DataLayout &dataLayout;
  /// The key is the address of the children array, which a type owns for good.
  llvm::DenseMap<const Type *, SmallVector<uint64_t>> offsets;
  llvm::DenseMap<PlacesType, SmallVector<uint64_t>> placeOffsets;
  llvm::DenseMap<Type, SmallVector<uint64_t>> cellStrides;
  SmallVector<uint64_t> rootOffsets;
  std::optional<SmallVector<SparseNode>> nodes;
  /// The number of a sparse level, by its SparseNode::position.
  llvm::DenseMap<ArrayRef<unsigned>, unsigned> numberOfNode;
};

/// Finds the places of a tree by name. The index of a tree lives as long as the
/// context, like the tree's type. Safe to call from several threads.
class PlaceIndex : public DialectInterface::Base<PlaceIndex> {
public:
  MLIR_DEFINE_EXPLICIT_INTERNAL_INLINE_TYPE_ID(PlaceIndex)
  explicit PlaceIndex(Dialect *dialect) : Base(dialect) {}

  std::optional<PlacePath> find(RootType root, StringRef name) const;

private:
  /// The path to a place: for each level its child number in the level above,
  /// then the child number of the record, then the number of the place in the
  /// record.
  using Position = SmallVector<unsigned, 4>;
  using Places = llvm::StringMap<Position>;
  const Places &placesOf(RootType root) const;

  mutable std::mutex mutex;
  mutable llvm::DenseMap<RootType, std::unique_ptr<Places>> known;
};

} // namespace mlir::tai

#endif // TAI_DIALECT_TAI_IR_TREELAYOUT_H
