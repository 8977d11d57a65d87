//===- BlockLoop.h - Analysis of loops over blocks --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The innermost level of a field divides its index space into blocks. This
// describes a loop over such a field: the shape of a block, which of its
// dimensions is contiguous (a row), the form of each index of an access, and in
// which blocks all conditions on indices are constant (the interior).
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_VECTORIZE_BLOCKLOOP_H
#define TAI_LIB_TRANSFORMS_VECTORIZE_BLOCKLOOP_H

#include "mlir/IR/IRMapping.h"
#include "tai/Transforms/Utils/FieldAddress.h"
#include "llvm/ADT/MapVector.h"

namespace mlir::tai {

/// An index of an access: a loop-invariant value, or an induction variable plus
/// a constant.
struct IndexForm {
  Value invariant;
  unsigned variable = 0;
  int64_t shift = 0;

  bool isShift() const { return !invariant; }
};

/// A memory access of the loop and its analysed indices.
struct BlockAccess {
  Operation *op;
  const FieldInfo *field;
  SmallVector<IndexForm> indices;
  /// The position of the accessed component in an element.
  int64_t component = 0;
  /// The number of the index that varies along the row; none for an access that
  /// is the same for the whole row.
  std::optional<unsigned> rowIndex;
};

/// Returns the digit of an index along the dimension that counts single
/// elements; null if there is none.
const IndexDigit *findInnermost(const FieldInfo &field, unsigned dimension);

class BlockLoop {
public:
  /// Analyses the loop; nullopt if its iterations cannot be executed a whole
  /// row of elements at a time.
  static std::optional<BlockLoop> analyze(ParallelForOp loop,
                                          FieldTable &fields);

  ParallelForOp loop;
  const FieldInfo *field = nullptr;
  /// The extent of a block of the loop along each dimension.
  SmallVector<int64_t> extents;
  /// The dimension along which the rows of a block run.
  unsigned rowDimension = 0;
  int64_t rowLength() const { return extents[rowDimension]; }

  /// The memory accesses of the loop, in program order.
  llvm::MapVector<Operation *, BlockAccess> accesses;
  /// The conditions that are constant in the interior, and their values. The
  /// interior is the range of blocks [lower, upper).
  llvm::DenseMap<Value, bool> answers;
  SmallVector<int64_t> lower, upper;
  /// A neighbouring cell that must be active in the interior: the queried
  /// field, the number of levels up, and the distance in blocks along each
  /// dimension.
  struct Neighbour {
    FlatSymbolRefAttr field;
    int64_t up;
    SmallVector<int64_t> distance;
    bool operator==(const Neighbour &other) const {
      return field == other.field && up == other.up &&
             distance == other.distance;
    }
  };
  SmallVector<Neighbour> neighbours;
  /// Stores to fields whose cell must be activated before.
  SmallVector<BlockAccess *> activations;
  /// The number of ops of an iteration in the interior.
  int64_t numOps = 0;

private:
  bool findBlock(FieldTable &fields);
  void findAnswers(FieldTable &fields);
  bool addNeighbours(IsActiveOp op, FieldTable &fields);
  bool coversBlocks(const FieldInfo &other, unsigned level) const;
  bool analyzeBody(Block &block, FieldTable &fields);
  bool addAccess(Operation *op, FieldTable &fields);
  bool getForm(Value index, IndexForm &form);
  bool isRowAccess(BlockAccess &access);
  bool canWrite(BlockAccess &access);
  /// Restricts the interior to blocks in which the access stays within its
  /// field.
  void require(const BlockAccess &access);
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_VECTORIZE_BLOCKLOOP_H
