//===- LoopTrajectory.h - Recording of loops, checkpointed ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The recording of carried values that the reverse of a serial loop needs and
// that only a run of the loop can produce: buffers, the loops that write them,
// and the checkpointing schedule.
//
// A loop of few iterations records all of them. A loop of many iterations, or
// of a number known only at run time, is recorded in chunks of about the square
// root of that number of iterations: the first pass keeps a checkpoint at the
// start of each chunk, and records the last chunk; each other chunk is re-run
// and recorded before its reverse. While the whole record is small, there is
// one chunk, and nothing is re-run.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_REVERSE_LOOPTRAJECTORY_H
#define TAI_AD_REVERSE_LOOPTRAJECTORY_H

#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "tai/AD/Reverse/AdjointBuilder.h"

namespace mlir::tai {

/// The loop over iterations from last to first, while its body is built.
struct ReverseDraft {
  scf::ForOp loop;
  SmallVector<Value> inits;
  /// In the body: the number of the last iteration in the chunk, and the number
  /// of this iteration in the chunk and in the loop.
  Operation *last = nullptr, *local = nullptr, *iteration = nullptr;
};

class LoopTrajectory {
public:
  LoopTrajectory(AdjointBuilder &builder, Operation *loop)
      : b(builder), loop(loop), around(builder.getFrame()) {}

  /// Sets the loop that re-runs the iterations, and their number. Call before
  /// `load`.
  void setForward(scf::ForOp loop, Value trips) {
    forward = loop;
    count = trips;
  }
  /// Carried value number `index` at the start of the iteration of `frame`.
  Value load(Frame &frame, unsigned index, const ReverseDraft &draft);

  /// Makes the forward loop write the record of all iterations or of the last
  /// chunk. Call when the body of the reverse is complete.
  void record();
  /// The reverse loop, with the body of `draft`, which is left empty.
  scf::ForOp createReverse(ReverseDraft &draft, ArrayRef<Value> inits,
                           ArrayRef<Value> yields);
  /// Frees the buffers, after the reverse loop.
  void release();

  /// How many values are recorded.
  size_t size() const { return histories.size(); }
  bool isRecorded(unsigned index) const { return histories.contains(index); }
  bool isChunked() const { return static_cast<bool>(chunks.size); }
  /// True if the value is part of the checkpoint of each chunk.
  bool isKeptByChunks(unsigned index) const { return starts.contains(index); }
  int64_t getBytesPerIteration();
  static int64_t getBytes(Type type);

private:
  struct Chunks {
    /// Iterations in each chunk but the last; null if there certainly is one
    /// chunk.
    Value size;
    Value number;
    /// Iterations in the longest chunk: the size of the buffers.
    Value room;
  };

  Chunks createChunks();
  void recordChunks();
  void storeRecorded(scf::ForOp recorder);
  Value getStart(unsigned index, Value chunk);
  scf::ForOp createReverseChunks(ReverseDraft &draft, ArrayRef<Value> inits,
                                 ArrayRef<Value> yields);
  scf::ForOp finishReverse(scf::ForOp reverse, ReverseDraft &draft,
                           ArrayRef<Value> yields);
  std::pair<Value, Value> createRange(Value begin, Value end);

  AdjointBuilder &b;
  Operation *loop;
  Frame &around;
  Value count;
  /// The loop that runs the iterations forward and records them. If there are
  /// chunks: the loop over the chunks, and the loop over iterations inside it.
  scf::ForOp forward, inner;
  Chunks chunks;
  /// Buffers by carried value: of the record, and of the checkpoints.
  llvm::SmallMapVector<unsigned, memref::AllocOp, 4> histories;
  llvm::SmallMapVector<unsigned, memref::AllocOp, 4> starts;
};

} // namespace mlir::tai

#endif // TAI_AD_REVERSE_LOOPTRAJECTORY_H
