//===- FieldAddress.h - Addresses of the elements of fields -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Emits the address of a field access from its indices, and the number of the
// cell that must be active for the access.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_FIELDADDRESS_H
#define TAI_TRANSFORMS_UTILS_FIELDADDRESS_H

#include "mlir/IR/Builders.h"
#include "tai/Analysis/FieldTable.h"

namespace mlir::tai {

/// Emits the zero-based indices of an access: `indices` minus the offset of the
/// field.
SmallVector<Value> emitZeroBased(OpBuilder &builder, Location loc,
                                 const FieldInfo &field, ValueRange indices);

/// Emits the value of `digit`, the part of an index that one level of the
/// layout selects by, for the zero-based indices of the field.
Value emitDigit(OpBuilder &builder, Location loc, const FieldInfo &field,
                const IndexDigit &digit, ValueRange zeroBased);

/// Emits the row-major position of a component in an element of the given
/// shape.
Value emitComponent(OpBuilder &builder, Location loc,
                    ArrayRef<int64_t> elementShape, ValueRange components);

/// Emits the offset, counted in components, from the first component of the
/// field to the component at the zero-based indices.
Value emitElementOffset(OpBuilder &builder, Location loc,
                        const FieldInfo &field, ValueRange zeroBased,
                        ValueRange components);

/// Emits the number of the cell at position `level` of the path to the field's
/// place.
Value emitCellNumber(OpBuilder &builder, Location loc, const FieldInfo &field,
                     unsigned level, ValueRange zeroBased);

/// The innermost `dynamic` level (whose cells are lists) above a field, which
/// must have one.
const SparseInfo &getInnermostList(const FieldInfo &field);
/// Emits the number of the list, in the innermost `dynamic` level, that an
/// access refers to. `indices` are the indices of the field without the index
/// along the list.
Value emitListNumber(OpBuilder &builder, Location loc, const FieldInfo &field,
                     ValueRange indices);
/// The position, among the indices of the field, of the index along the list.
unsigned getListDimension(const FieldInfo &field);

/// Emits the length of a list of a `dynamic` level, as an index.
Value emitLength(OpBuilder &builder, Location loc, const SparseInfo &sparse,
                 Value tree, Value list);

/// The alignment that a component has in all elements of a field, if greater
/// than its size; else 0. Such an alignment lets neighbouring components be
/// accessed together.
unsigned getAlignment(const FieldInfo &field, ValueRange components);

/// Emits the base address of the tree that holds a field.
Value emitTreeBase(OpBuilder &builder, Location loc, const FieldInfo &field);

/// Emits the address that lies `bytes` behind the base of the tree of a field.
Value emitTreeAddress(OpBuilder &builder, Location loc, const FieldInfo &field,
                      uint64_t bytes);

/// Emits the address of the first component of a field.
Value emitFieldBase(OpBuilder &builder, Location loc, const FieldInfo &field);

/// The type in which memory holds a scalar: i1 takes a byte.
Type getStorageType(Type scalar);

/// Emits the pointer &base[offset] for elements of the given storage type.
Value emitPointer(OpBuilder &builder, Location loc, Type storageType,
                  Value base, Value offset);

/// Strips small constant offsets from the zero-based indices of an access, in
/// dimensions with a single stride. Returns the constants, one for each index.
SmallVector<int64_t> peelConstants(OpBuilder &builder, Location loc,
                                   const FieldInfo &field,
                                   MutableArrayRef<Value> zeroBased);

/// Emits the address of a component of an element, from indices without the
/// constants `peeled` (see peelConstants). These constants are added last, like
/// a constant component, so that the addresses of neighbouring elements differ
/// by a constant only.
Value emitNearPointer(OpBuilder &builder, Location loc, const FieldInfo &field,
                      Value base, ValueRange indices, ArrayRef<int64_t> peeled,
                      ValueRange components);

/// Emits the load or store of a scalar in the type in which memory holds it.
Value emitLoad(OpBuilder &builder, Location loc, Type scalar, Value pointer,
               AliasScopes scopes);
void emitStore(OpBuilder &builder, Location loc, Value value, Value pointer,
               AliasScopes scopes);

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_FIELDADDRESS_H
