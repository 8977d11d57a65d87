//===- FieldAddress.h - Addresses of the elements of fields -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Emits the address of an access from its indices, and the number of the cell
// that must be active for it.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_FIELDADDRESS_H
#define TAI_TRANSFORMS_UTILS_FIELDADDRESS_H

#include "mlir/IR/Builders.h"
#include "tai/Analysis/FieldTable.h"

namespace mlir::tai {

/// The indices minus the offset of the field: zero-based.
SmallVector<Value> emitZeroBased(OpBuilder &builder, Location loc,
                                 const FieldInfo &field, ValueRange indices);

/// The value of `digit` for the zero-based indices of the field.
Value emitDigit(OpBuilder &builder, Location loc, const FieldInfo &field,
                const IndexDigit &digit, ValueRange zeroBased);

/// Row-major position of a component in an element.
Value emitComponent(OpBuilder &builder, Location loc,
                    ArrayRef<int64_t> elementShape, ValueRange components);

/// The offset from the first component of the field to the component at the
/// zero-based indices, in components.
Value emitElementOffset(OpBuilder &builder, Location loc,
                        const FieldInfo &field, ValueRange zeroBased,
                        ValueRange components);

/// The number of the cell at position `level` of the path.
Value emitCellNumber(OpBuilder &builder, Location loc, const FieldInfo &field,
                     unsigned level, ValueRange zeroBased);

/// The innermost `dynamic` level above a field, which must have one.
const SparseInfo &getInnermostList(const FieldInfo &field);
/// The number of the list in the innermost `dynamic` level. `indices` are the
/// indices of the field without the index along the list.
Value emitListNumber(OpBuilder &builder, Location loc, const FieldInfo &field,
                     ValueRange indices);
/// The position of the index along the list.
unsigned getListDimension(const FieldInfo &field);

/// The length of a list of a `dynamic` level, as an index.
Value emitLength(OpBuilder &builder, Location loc, const SparseInfo &sparse,
                 Value tree, Value list);

/// The common alignment of a component in all elements, if greater than its
/// size; else 0. Such an alignment lets neighbouring components be accessed
/// together.
unsigned getAlignment(const FieldInfo &field, ValueRange components);

/// The base address of the tree of a field.
Value emitTreeBase(OpBuilder &builder, Location loc, const FieldInfo &field);

/// The address at an offset in the tree of a field.
Value emitTreeAddress(OpBuilder &builder, Location loc, const FieldInfo &field,
                      uint64_t bytes);

/// The address of the first component of a field.
Value emitFieldBase(OpBuilder &builder, Location loc, const FieldInfo &field);

/// How a scalar is stored: i1 takes a byte.
Type getStorageType(Type scalar);

/// &base[offset] for elements of the given storage type.
Value emitPointer(OpBuilder &builder, Location loc, Type storageType,
                  Value base, Value offset);

/// Strips small constant offsets from indices whose dimension has a single
/// stride. Returns the constants, one for each index.
SmallVector<int64_t> peelConstants(OpBuilder &builder, Location loc,
                                   const FieldInfo &field,
                                   MutableArrayRef<Value> zeroBased);

/// The address of a component of an element, from indices without the constants
/// `peeled`. These constants are added last, like a constant component, so that
/// the addresses of neighbouring elements differ by a constant only.
Value emitNearPointer(OpBuilder &builder, Location loc, const FieldInfo &field,
                      Value base, ValueRange indices, ArrayRef<int64_t> peeled,
                      ValueRange components);

/// Loads or stores a scalar.
Value emitLoad(OpBuilder &builder, Location loc, Type scalar, Value pointer,
               AliasScopes scopes);
void emitStore(OpBuilder &builder, Location loc, Value value, Value pointer,
               AliasScopes scopes);

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_FIELDADDRESS_H
