//===- LoopTrajectory.h - Recording of loops, checkpointed ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The carried values that the reverse of a serial loop needs and that only a
// run of the loop knows: their buffers, who writes them, and how much of the
// loop they hold at once.
//
// A loop of few iterations records them all. One of many, or of a number that
// only the run knows, is recorded in chunks of about the square root of that
// number: the first pass keeps what each chunk began with, and ends with a
// record of the last one; each of the others is run and recorded again before
// its reverse. While the whole record is small, the chunk is the whole loop, so
// that nothing is run again.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_LOOPTRAJECTORY_H
#define TAI_AD_LOOPTRAJECTORY_H

#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "tai/AD/AdjointBuilder.h"

namespace mlir::tai {

/// The loop over iterations from the last to the first, while its body is made.
struct ReverseDraft {
  scf::ForOp loop;
  SmallVector<Value> inits;
  /// In the body: the number of the last iteration in the chunk, that of this
  /// one, and that of this one in the loop.
  Operation *last = nullptr, *local = nullptr, *iteration = nullptr;
};

class LoopTrajectory {
public:
  LoopTrajectory(AdjointBuilder &builder, Operation *loop)
      : b(builder), loop(loop), around(builder.getFrame()) {}

  /// Says which loop runs the iterations forward again, and how many there are:
  /// before anything is loaded.
  void setForward(scf::ForOp loop, Value trips) {
    forward = loop;
    count = trips;
  }
  /// What carried value `index` was when the iteration of `frame` began.
  Value load(Frame &frame, unsigned index, const ReverseDraft &draft);

  /// When the body of the reverse is complete: lets the forward loop write the
  /// record, whole or of its last chunk.
  void record();
  /// The reverse, with the body of the draft, which is left empty.
  scf::ForOp createReverse(ReverseDraft &draft, ArrayRef<Value> inits,
                           ArrayRef<Value> yields);
  /// After it.
  void release();

  /// How many values are recorded.
  size_t size() const { return histories.size(); }
  bool isRecorded(unsigned index) const { return histories.contains(index); }
  bool isChunked() const { return static_cast<bool>(chunks.size); }
  /// True if every chunk keeps the value that it begins with.
  bool isKeptByChunks(unsigned index) const { return starts.contains(index); }
  int64_t getBytesPerIteration();
  static int64_t getBytes(Type type);

private:
  struct Chunks {
    /// Iterations in each but the last; null if there is one chunk for sure.
    Value size;
    Value number;
    /// Iterations in the longest.
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
  /// chunks: the loop over these, and the one inside.
  scf::ForOp forward, inner;
  Chunks chunks;
  /// What is recorded, by carried value, and what every chunk begins with.
  llvm::SmallMapVector<unsigned, memref::AllocOp, 4> histories;
  llvm::SmallMapVector<unsigned, memref::AllocOp, 4> starts;
};

} // namespace mlir::tai

#endif // TAI_AD_LOOPTRAJECTORY_H
