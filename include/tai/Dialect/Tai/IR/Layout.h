//===- Layout.h - Paths and addresses in layouts ----------------*- C++ -*-===//
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

// The syntax of levels, for level types of other dialects: `[i: 8, j: 4]`, then
// the children, each preceded by a comma.
ParseResult parseLevelAxes(AsmParser &parser, SmallVector<unsigned> &axes,
                           SmallVector<int64_t> &shape);
ParseResult parseLevelChildren(AsmParser &parser, SmallVector<Type> &children);
void printLevelAxes(AsmPrinter &printer, ArrayRef<unsigned> axes,
                    ArrayRef<int64_t> shape);
void printLevelChildren(AsmPrinter &printer, ArrayRef<Type> children);

/// The symbol of the field that an op accesses, loops over or queries; null if
/// there is none. Ops of other dialects name their field through
/// FieldAccessOpInterface.
FlatSymbolRefAttr getNamedField(Operation *op);

/// One level of the layout tree on the path from the root to a place (the
/// position of a field's values in the tree).
struct PathLevel {
  SNodeTypeInterface type;
  /// The position of this level among the children of the level above.
  unsigned child;
};

/// Describes how one level of a layout divides one dimension of a field: the
/// digit of index x is (x / divisor) % extent. An increment of the digit
/// advances the address by `stride` bytes, and the cell number in the level by
/// `weight`.
struct IndexDigit {
  unsigned dimension; // position among the indices of the field
  unsigned level;     // position on the path
  int64_t divisor;
  int64_t extent;
  uint64_t stride;
  int64_t weight;
  /// True if the digit (the part of an index that one level of the layout uses)
  /// is the whole index: the divisor is 1 and no level above divides the
  /// dimension.
  bool isWhole;
};

/// The path from the root of a layout tree to a place, with derived properties.
struct PlacePath {
  SmallVector<PathLevel> levels;
  PlacesType places;
  unsigned place;             // position in `places`
  unsigned placesChild;       // position of `places` in the innermost cell
  SmallVector<unsigned> axes; // axes divided, ascending
  SmallVector<int64_t> shape; // extent along each of `axes`

  Type getElementType() const { return places.getTypes()[place]; }
  unsigned getRank() const { return axes.size(); }
  /// The first sparse level on the path to a place, if any.
  SNodeTypeInterface getFirstSparse() const;
};

/// Finds the place called `name` in a layout tree.
std::optional<PlacePath> findPlace(RootType root, StringRef name);

/// Calls `callback` with all places of a layout tree in storage order.
void walkPlaces(RootType root,
                function_ref<void(const PlacePath &path)> callback);

/// A field, its place in the layout tree, and its index space, in the order of
/// the field's indices.
struct FieldLayout {
  FieldOp field;
  TreeOp tree;
  PlacePath path;
  /// The axis of the layout that each index of the field stands for.
  SmallVector<unsigned> axisOfIndex;
  /// The extent of each index of the field.
  SmallVector<int64_t> shape;
  /// The first valid value of each index of the field.
  SmallVector<int64_t> offset;
};

/// Returns the layout of a field whose op has been verified.
FailureOr<FieldLayout> getFieldLayout(FieldOp field);

/// True if, for all indices, the element of field `a` is active exactly if the
/// element of field `b` is active.
bool haveSameActivity(const FieldLayout &a, const FieldLayout &b);

/// Returns the declaration of the field called `name` that is visible from the
/// op `from`, or null.
FieldOp lookupField(Operation *from, FlatSymbolRefAttr name);

/// A sparse level of a layout tree. Every cell has an address whether it is
/// active or not (see docs/decisions/0006-sparse-storage.md); cells are
/// numbered row-major, level below level.
struct SparseNode {
  SNodeTypeInterface type;
  /// The path from the root to this sparse level: the position of each level
  /// among the children of the level above.
  SmallVector<unsigned> position;
  /// The number of the nearest sparse level above this level.
  std::optional<unsigned> parent;
  /// How the number of a cell becomes its address. There is one step for each
  /// level down to this one, and for each axis of a level whose cells are not
  /// contiguous: the number of cells below one parent cell, and the distance
  /// between them in bytes.
  struct Step {
    int64_t cells;
    uint64_t stride;
  };
  SmallVector<Step> steps;
  /// The offset of the level's first cell, in bytes from the base of the tree.
  uint64_t offset = 0;
  /// The offset of the level's activity data in the tree: one bit for each
  /// cell, in words of 64 bits, or for `dynamic` the length of each list, in 32
  /// bits.
  uint64_t activityOffset = 0;

  /// The number of cells of this sparse level in the whole tree.
  int64_t getNumCells() const;
};

/// Lists the sparse levels of a layout tree, parents before children.
SmallVector<SparseNode> getSparseNodes(RootType root,
                                       const DataLayout &dataLayout);

/// The address function of a field: the digits of its indices, and the offset
/// of the place when all digits are zero, in bytes from the base of the tree.
struct FieldStorage {
  SmallVector<IndexDigit> digits;
  uint64_t offset = 0;
  /// A sparse level on the path to the field: its position on the path, and its
  /// number among the sparse levels of the tree.
  struct SparseLevel {
    unsigned level;
    unsigned node;
  };
  SmallVector<SparseLevel> sparse;
};
FieldStorage getFieldStorage(const FieldLayout &layout,
                             const DataLayout &dataLayout);

/// The size of a tree in bytes: of its cells alone, and including the activity
/// data of sparse levels.
struct TreeSize {
  uint64_t cells, total;
};
TreeSize getTreeSize(RootType root, const DataLayout &dataLayout);

/// The offset in bytes of child number `index` in a cell with the given
/// children.
uint64_t getChildOffset(ArrayRef<Type> children, unsigned index,
                        const DataLayout &dataLayout);

/// The offset in bytes of place number `index` in its record, which is a group
/// of places stored element by element.
uint64_t getPlaceOffset(PlacesType places, unsigned index,
                        const DataLayout &dataLayout);

/// The size and alignment in bytes of a value stored in a place. Vectors store
/// their components one after another, each in its own size (i1 takes a byte).
uint64_t getValueSize(Type type, const DataLayout &dataLayout);
uint64_t getValueAlignment(Type type, const DataLayout &dataLayout);

} // namespace mlir::tai

#endif // TAI_DIALECT_TAI_IR_LAYOUT_H
