//===- Layout.h - Where the elements of a field are -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Answers questions about a layout type: which levels lie on the path to a
// place, how its indices split into digits, and where a cell is stored.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_LAYOUT_H
#define TAI_DIALECT_TAI_IR_LAYOUT_H

#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// The number of axes a layout can divide, and their letters: i, j, k, …, t.
constexpr unsigned kMaxAxes = 12;
char getAxisLetter(unsigned axis);
std::optional<unsigned> parseAxisLetter(StringRef letter);

/// One level on the path from the root to a place.
struct PathLevel {
  SNodeTypeInterface type;
  /// Position of this level among the children of the level above.
  unsigned child;
};

/// How one level divides one dimension of a field: the digit of index x is
/// (x / divisor) % extent, and is worth `stride` bytes where the level is
/// dense.
struct IndexDigit {
  unsigned dimension; // position among the indices of the field
  unsigned level;     // position on the path
  int64_t divisor;
  int64_t extent;
  uint64_t stride;
  /// The digit is the whole index: divisor 1 and no level above divides it.
  bool isWhole;
};

/// The path to a place and what follows from it.
struct PlacePath {
  SmallVector<PathLevel> levels;
  PlacesType places;
  unsigned place;             // position in `places`
  unsigned placesChild;       // position of `places` in the innermost cell
  SmallVector<unsigned> axes; // axes divided, ascending
  SmallVector<int64_t> shape; // extent along each of `axes`

  Type getElementType() const { return places.getTypes()[place]; }
  unsigned getRank() const { return axes.size(); }
  /// The first sparse level on the path, if any.
  SNodeTypeInterface getFirstSparse() const;
};

/// Finds the place of the given name in a tree.
std::optional<PlacePath> findPlace(RootType root, StringRef name);

/// All places of a tree in storage order.
void walkPlaces(RootType root,
                function_ref<void(const PlacePath &path)> callback);

/// A field, its place, and its index space in the order of its indices.
struct FieldLayout {
  FieldOp field;
  TreeOp tree;
  PlacePath path;
  /// Axis of each index.
  SmallVector<unsigned> axisOfIndex;
  /// Extent of each index.
  SmallVector<int64_t> shape;
  /// First value of each index.
  SmallVector<int64_t> offset;
};

/// The layout of a field that verifies; `from` is any op below the symbol table
/// that holds it.
FailureOr<FieldLayout> getFieldLayout(FieldOp field);

/// The field of that name visible from `from`, or null.
FieldOp lookupField(Operation *from, FlatSymbolRefAttr name);

/// Storage of a path whose levels are all dense: the digits of its indices, and
/// the offset of the place when all digits are zero, in bytes from the base of
/// the tree. Fails at a sparse level.
struct DenseStorage {
  SmallVector<IndexDigit> digits;
  uint64_t offset = 0;
};
FailureOr<DenseStorage> getDenseStorage(const FieldLayout &layout,
                                        const DataLayout &dataLayout);

/// Size in bytes of a tree whose levels are all dense.
uint64_t getTreeSize(RootType root, const DataLayout &dataLayout);

/// Offset in bytes of child `index` in a cell that holds `children`.
uint64_t getChildOffset(ArrayRef<Type> children, unsigned index,
                        const DataLayout &dataLayout);

/// Offset in bytes of place `index` in its record.
uint64_t getPlaceOffset(PlacesType places, unsigned index,
                        const DataLayout &dataLayout);

/// Bytes and alignment of a value stored in a place: components one after
/// another, each in its own size (i1 takes a byte).
uint64_t getValueSize(Type type, const DataLayout &dataLayout);
uint64_t getValueAlignment(Type type, const DataLayout &dataLayout);

} // namespace mlir::tai

#endif // TAI_DIALECT_TAI_IR_LAYOUT_H
