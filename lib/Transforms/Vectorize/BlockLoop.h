//===- BlockLoop.h - What a loop over blocks does ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The innermost level of a field cuts its index space into blocks. This
// describes a loop over such a field: the shape of a block, which of its
// dimensions is contiguous (a row), what each index of an access is, and in
// which blocks all questions about the indices have one answer.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_VECTORIZE_BLOCKLOOP_H
#define TAI_LIB_TRANSFORMS_VECTORIZE_BLOCKLOOP_H

#include "mlir/IR/IRMapping.h"
#include "tai/Transforms/Utils/FieldAddress.h"
#include "llvm/ADT/MapVector.h"

namespace mlir::tai {

/// An index of an access: a value that is the same in all iterations, or an
/// induction variable plus a constant.
struct IndexForm {
  Value invariant;
  unsigned variable = 0;
  int64_t shift = 0;

  bool isShift() const { return !invariant; }
};

/// An access, with what its op has to say.
struct BlockAccess {
  Operation *op;
  const FieldInfo *field;
  SmallVector<IndexForm> indices;
  /// Position of the component in an element.
  int64_t component = 0;
  /// The index that runs along the row; none for what a row reads once.
  std::optional<unsigned> rowIndex;
};

/// The digit of an index that counts single elements, or null.
const IndexDigit *findInnermost(const FieldInfo &field, unsigned dimension);

class BlockLoop {
public:
  /// Describes the loop; nothing if it cannot run on whole rows.
  static std::optional<BlockLoop> analyze(ParallelForOp loop,
                                          FieldTable &fields);

  ParallelForOp loop;
  const FieldInfo *field = nullptr;
  /// Extent of a block along each dimension; 1 where blocks are one thick.
  SmallVector<int64_t> extents;
  /// The dimension along which a row runs.
  unsigned rowDimension = 0;
  int64_t rowLength() const { return extents[rowDimension]; }

  /// What is done with the elements, in order.
  llvm::MapVector<Operation *, BlockAccess> accesses;
  /// The answers in the interior: blocks that lie in [lower, upper).
  llvm::DenseMap<Value, bool> answers;
  SmallVector<int64_t> lower, upper;
  /// Cells around a block that must be active in the interior: the field that
  /// asks, how many levels up, and how many blocks away along each dimension.
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
  /// Stores whose cell has to be made active, by one op for each level.
  SmallVector<BlockAccess *> activations;
  /// Ops of an iteration in the interior.
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
  /// All iterations of the interior read and write within the fields.
  void require(const BlockAccess &access);
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_VECTORIZE_BLOCKLOOP_H
