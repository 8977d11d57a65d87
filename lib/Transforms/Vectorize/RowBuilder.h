//===- RowBuilder.h - Vector code for the rows of a block -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Emits the iterations of one row of a block as operations on vectors with one
// element for each iteration. Uniform values stay scalars.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_VECTORIZE_ROWBUILDER_H
#define TAI_LIB_TRANSFORMS_VECTORIZE_ROWBUILDER_H

#include "BlockLoop.h"
#include "tai/Transforms/Utils/IndexMath.h"
#include <map>

namespace mlir::tai {

class RowBuilder {
public:
  /// Builds vector code for the rows of one block. `origin`: the indices of the
  /// block's first element.
  RowBuilder(OpBuilder &builder, const BlockLoop &block, FieldTable &fields,
             ValueRange origin);

  /// Emits the iterations of one row as vector ops. The row begins at these
  /// distances from the block's first element; the distance along the row is
  /// ignored.
  void emitRow(ArrayRef<OpFoldResult> distances);

private:
  void emitBody(Block &body);
  void emitAccess(const BlockAccess &access);
  void emitOp(Operation *op);
  void findNeeded();

  /// Load the row of elements that an access reaches as a vector, or store a
  /// vector to it.
  Value loadRow(const BlockAccess &access);
  void storeRow(const BlockAccess &access, Value vector);
  /// Loads the elements that an access would reach if the row of iterations
  /// were `blocks` blocks further along the row dimension.
  Value loadPart(const BlockAccess &access, int64_t blocks);
  /// The key of a loaded row: the place of its field, and for each index its
  /// variable (or value) and its distance from the origin.
  using RowKey =
      std::pair<Attribute, SmallVector<std::pair<const void *, int64_t>>>;
  struct RowOrder {
    bool operator()(const RowKey &a, const RowKey &b) const {
      return std::tuple(a.first.getAsOpaquePointer(), a.second) <
             std::tuple(b.first.getAsOpaquePointer(), b.second);
    }
  };
  RowKey getKey(const BlockAccess &access, int64_t blocks) const;
  Value emitRowPointer(const BlockAccess &access, int64_t blocks);
  Value emitIndex(const BlockAccess &access, const IndexDigit &digit,
                  int64_t blocks);

  /// Returns a value as a vector over the iterations of the row.
  Value toVector(Value value);
  Value broadcast(Value scalar);
  VectorType vectorOf(Type scalar) const {
    return VectorType::get({block.rowLength()}, scalar);
  }
  /// getStep: the distance, in elements, of consecutive accesses of a row.
  /// getFirst: the position of the row's first access in its cell.
  int64_t getStep(const BlockAccess &access) const;
  int64_t getFirst(const BlockAccess &access) const;
  /// Returns the shift of an access along the row: its index in the first
  /// iteration minus the loop index.
  int64_t getRowShift(const BlockAccess &access) const;
  bool isWhole(const BlockAccess &access) const;
  const IndexDigit &getRowDigit(const BlockAccess &access) const;

  OpBuilder &builder;
  const BlockLoop &block;
  FieldTable &fields;
  Location loc;
  IndexMath math;
  SmallVector<Value> origin;    // zero-based
  SmallVector<OpFoldResult> at; // distances of the row
  /// Maps values of the loop body to emitted values, which are scalars if they
  /// are the same for the whole row.
  IRMapping values;
  llvm::DenseSet<Operation *> needed;
  /// written: places of fields that the loop writes. rows: loaded rows of other
  /// places, which are reused, because a load shortly after a store to nearby
  /// memory stalls.
  llvm::DenseSet<Attribute> written;
  std::map<RowKey, Value, RowOrder> rows;
  llvm::DenseMap<Value, Value> vectors;
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_VECTORIZE_ROWBUILDER_H
