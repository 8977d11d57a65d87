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

/// The loop over iterations from last to first, while the body of the loop is
/// built.
struct ReverseDraft {
  scf::ForOp loop;
  SmallVector<Value> inits;
  /// Values in the body of the reverse loop: the number of the last iteration
  /// in the chunk, and the number of the current iteration in the chunk and in
  /// the whole loop.
  Operation *last = nullptr, *local = nullptr, *iteration = nullptr;
};

class LoopTrajectory {
public:
  LoopTrajectory(AdjointBuilder &builder, Operation *loop)
      : b(builder), loop(loop), around(builder.getFrame()) {}

  /// Sets the loop that re-runs the primal iterations, and the number of
  /// iterations. Must be called before `load`.
  void setForward(scf::ForOp loop, Value trips) {
    forward = loop;
    count = trips;
  }
  /// Loads the value that carried value number `index` has at the start of the
  /// primal iteration of `frame`.
  Value load(Frame &frame, unsigned index, const ReverseDraft &draft);

  /// Makes the forward loop store carried values of all iterations, or of the
  /// last chunk, to the history buffers. Must be called when the body of the
  /// reverse loop is complete.
  void record();
  /// Creates the final reverse loop from the body of `draft`, which is left
  /// empty.
  scf::ForOp createReverse(ReverseDraft &draft, ArrayRef<Value> inits,
                           ArrayRef<Value> yields);
  /// Frees the history buffers, after the reverse loop.
  void release();

  /// The number of carried values that are recorded.
  size_t size() const { return histories.size(); }
  bool isRecorded(unsigned index) const { return histories.contains(index); }
  bool isChunked() const { return static_cast<bool>(chunks.size); }
  /// True if a carried value is part of the checkpoint at the start of each
  /// chunk.
  bool isKeptByChunks(unsigned index) const { return starts.contains(index); }
  int64_t getBytesPerIteration();
  static int64_t getBytes(Type type);

private:
  struct Chunks {
    /// The number of iterations in each chunk but the last; null if there
    /// certainly is one chunk.
    Value size;
    Value number;
    /// The number of iterations in the longest chunk, which is the size of the
    /// history buffers.
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
  /// The loop that runs the primal iterations forward and records them. With
  /// chunks: the loop over the chunks, and the loop over the iterations inside
  /// it.
  scf::ForOp forward, inner;
  Chunks chunks;
  /// Buffers by the number of the carried value: the history of its values, and
  /// its checkpoints at the starts of chunks.
  llvm::SmallMapVector<unsigned, memref::AllocOp, 4> histories;
  llvm::SmallMapVector<unsigned, memref::AllocOp, 4> starts;
};

} // namespace mlir::tai

#endif // TAI_AD_REVERSE_LOOPTRAJECTORY_H
