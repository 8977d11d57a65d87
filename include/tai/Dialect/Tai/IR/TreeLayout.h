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

/// The layout of one tree with cached offsets; used by one thread at a time.
class TreeLayout {
public:
  /// Refers to `dataLayout`, which must outlive this object.
  TreeLayout(RootType root, const DataLayout &dataLayout)
      : root(root), dataLayout(dataLayout) {}

  /// These three functions return the same as the functions of the same names
  /// in Layout.h, from sums that are computed once.
  ArrayRef<SparseNode> getSparseNodes();
  TreeSize getTreeSize();
  FieldStorage getFieldStorage(const FieldLayout &layout);

private:
  /// getRootOffset is the offset of child number `index` in the root of the
  /// tree; getOffset is its offset in a cell with `children`.
  uint64_t getRootOffset(unsigned index);
  uint64_t getOffset(ArrayRef<Type> children, unsigned index);
  uint64_t getOffsetOfPlace(PlacesType places, unsigned index);
  ArrayRef<uint64_t> getCellStrides(SNodeTypeInterface level);
  void findNodes(ArrayRef<Type> children, const SparseNode &above,
                 function_ref<uint64_t(unsigned)> offsetOf);
  void addSteps(SNodeTypeInterface level, SparseNode &node);

  RootType root;
  const DataLayout &dataLayout;
  /// Offsets of the children of a cell. The key is the address of the array of
  /// child types, which the cell's type owns until the end of the context.
  llvm::DenseMap<const Type *, SmallVector<uint64_t>> offsets;
  llvm::DenseMap<PlacesType, SmallVector<uint64_t>> placeOffsets;
  llvm::DenseMap<Type, SmallVector<uint64_t>> cellStrides;
  SmallVector<uint64_t> rootOffsets;
  std::optional<SmallVector<SparseNode>> nodes;
  /// Numbers of the sparse levels of the tree, by SparseNode::position.
  llvm::DenseMap<ArrayRef<unsigned>, unsigned> numberOfNode;
};

/// Finds a place (the position of a field's values in a layout tree) by its
/// name. For each tree type, the table of names is built on first use and kept
/// until the MLIR context ends, because types live as long. Thread-safe.
class PlaceIndex : public DialectInterface::Base<PlaceIndex> {
public:
  MLIR_DEFINE_EXPLICIT_INTERNAL_INLINE_TYPE_ID(PlaceIndex)
  explicit PlaceIndex(Dialect *dialect) : Base(dialect) {}

  std::optional<PlacePath> find(RootType root, StringRef name) const;

private:
  /// The path from the root of a tree to a place: for each level its child
  /// number in the level above, then the child number of the record, then the
  /// number of the place in the record.
  using Position = SmallVector<unsigned, 4>;
  using Places = llvm::StringMap<Position>;
  const Places &placesOf(RootType root) const;

  mutable std::mutex mutex;
  mutable llvm::DenseMap<RootType, std::unique_ptr<Places>> known;
};

} // namespace mlir::tai

#endif // TAI_DIALECT_TAI_IR_TREELAYOUT_H
