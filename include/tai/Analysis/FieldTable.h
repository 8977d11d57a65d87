//===- FieldTable.h - Fields and their places in memory ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The fields of a module: type, layout, the alias scopes of their accesses,
// and the parts of them that are evenly spaced in memory.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_FIELDTABLE_H
#define TAI_ANALYSIS_FIELDTABLE_H

#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include <memory>

namespace mlir::tai {

/// Name of the attribute that marks a write to a cell of a sparse level that is
/// known to be active.
constexpr llvm::StringLiteral kActiveAttrName = "tai.active";

/// Alias information of an access for LLVM; each may be null: its alias scope,
/// the noalias scopes, and its access groups.
struct AliasScopes {
  ArrayAttr own, others, groups;
  /// Alignment of the address in bytes; 0 stands for the alignment of the type.
  unsigned alignment = 0;
  /// The value of the attribute kDigitsAttrName of an access, or null.
  DenseI64ArrayAttr digits = nullptr;
};

/// The attribute that describes the address of a lowered field access: three
/// numbers for each digit of its indices and its component, which are the
/// stride in bytes, the extent, and the shift between this digit and the digit
/// of the non-constant part of the address.
constexpr llvm::StringLiteral kDigitsAttrName = "tai.digits";

/// A sparse level on the path to a field.
struct SparseInfo {
  SNodeTypeInterface type;
  unsigned level; // position on the path
  unsigned node;  // number in the tree
  uint64_t activityOffset;
  int64_t capacity; // of a list

  /// Refers to cell number `cell` of this sparse level as a CellRef.
  CellRef at(Value tree, Value cell) const {
    return {tree, node, activityOffset, capacity, cell};
  }
};

/// The data about one field that the lowering needs.
struct FieldInfo {
  FieldLayout layout;
  FieldStorage storage;
  /// The sparse levels on the path, outermost first.
  SmallVector<SparseInfo> sparse;
  /// Type of one component of an element, and its size in bytes.
  Type scalarType;
  int64_t scalarSize;
  /// Offset in bytes of the field's place within a cell of the innermost sparse
  /// level.
  uint64_t cellOffset = 0;
  SmallVector<int64_t> elementShape;
  int64_t numComponents;
  /// Identity of the storage: fields that name the same place share it.
  LLVM::AliasScopeAttr scope;

  /// Product of the extents of all dimensions.
  int64_t getNumElements() const {
    int64_t count = 1;
    for (int64_t extent : layout.shape)
      count *= extent;
    return count;
  }
};

/// The part of a field with some leading indices fixed, if its elements have a
/// uniform stride: element `e` (in storage order) of the remaining digits is at
/// base + e * cellStride.
struct FieldSlice {
  /// For each dimension of the field, true if the slice fixes the index along
  /// it.
  SmallVector<bool> fixed;
  int64_t cellStride; // bytes
  int64_t numCells;
  /// For each digit of the field's indices, in the order of
  /// FieldInfo::storage.digits: the stride of the digit in the slice, in cells.
  /// 0 for digits of fixed dimensions.
  SmallVector<int64_t> digitCells;
};

/// Finds the fields of a module, computes their layout once, and builds
/// addresses.
class FieldTable {
public:
  explicit FieldTable(Operation *root);

  /// Looks up the field called `name` that is visible from the op `user`.
  FailureOr<const FieldInfo *> lookup(Operation *user, FlatSymbolRefAttr name);

  /// The slice of `field` with the given dimensions fixed, if its stride is
  /// uniform. A fixed dimension with a digit inside a free dimension becomes
  /// free.
  static std::optional<FieldSlice> getSlice(const FieldInfo &field,
                                            ArrayRef<bool> fixed);

  /// The alias scopes for an access to `field`. The noalias scopes are the
  /// scopes of all places that this table has looked up so far.
  AliasScopes getScopes(const FieldInfo &field);

  /// The alias scopes for an access to an array argument of a kernel. Arrays
  /// may alias each other, but never a field.
  AliasScopes getArrayScopes();

private:
  LLVM::AliasScopeAttr makeScope(StringRef id);
  AliasScopes getScopes(LLVM::AliasScopeAttr scope);

  SymbolTable symbols;
  DataLayout dataLayout;
  LLVM::AliasScopeDomainAttr domain;
  llvm::DenseMap<StringAttr, std::unique_ptr<FieldInfo>> fields;
  SmallVector<LLVM::AliasScopeAttr> scopes;
  llvm::DenseMap<Attribute, ArrayAttr> otherScopes;
};

} // namespace mlir::tai

#endif // TAI_ANALYSIS_FIELDTABLE_H
