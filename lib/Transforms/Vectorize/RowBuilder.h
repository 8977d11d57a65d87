//===- RowBuilder.h - Vector code for the rows of a block -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Emits what the iterations of one row of a block do as operations on vectors
// with one element for each iteration. What is the same for all of them stays a
// scalar.
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
  /// `origin`: the indices of the first element of the block.
  RowBuilder(OpBuilder &builder, const BlockLoop &block, FieldTable &fields,
             ValueRange origin);

  /// Emits the row at these distances from the origin; that along the row is
  /// not used.
  void emitRow(ArrayRef<OpFoldResult> distances);

private:
  void emitBody(Block &body);
  void emitAccess(const BlockAccess &access);
  void emitOp(Operation *op);
  void findNeeded();

  /// The elements of a row that an access reads, or the row as it is stored for
  /// one that is written.
  Value loadRow(const BlockAccess &access);
  void storeRow(const BlockAccess &access, Value vector);
  /// `blocks`: how many rows of blocks further along the row.
  Value loadPart(const BlockAccess &access, int64_t blocks);
  /// What distinguishes rows of one block: the place, and for each index its
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

  /// A value for each iteration of the row.
  Value toVector(Value value);
  Value broadcast(Value scalar);
  VectorType vectorOf(Type scalar) const {
    return VectorType::get({block.rowLength()}, scalar);
  }
  /// How many elements apart the iterations of a row find theirs, and the first
  /// of them in its cell.
  int64_t getStep(const BlockAccess &access) const;
  int64_t getFirst(const BlockAccess &access) const;
  /// Index of the access to the first iteration minus the index of that.
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
  /// Values of the body: scalars where all iterations have the same.
  IRMapping values;
  llvm::DenseSet<Operation *> needed;
  /// Places that the loop writes, and rows of others that have been loaded: to
  /// load them again behind a store that is near would wait for it.
  llvm::DenseSet<Attribute> written;
  std::map<RowKey, Value, RowOrder> rows;
  llvm::DenseMap<Value, Value> vectors;
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_VECTORIZE_ROWBUILDER_H
