//===- LoopHistory.h - What a reversed loop knows of the loop ---*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The reverse of a serial loop, while it is being built: the loop over the
// iterations from the last to the first, and how each of them gets the values
// that the iteration began with.
//
// A value that is a formula of the iteration's number is computed; one that the
// next value gives back is carried backwards. The others are recorded by a
// second run of the loop, if a rule asks for them. A long run is recorded chunk
// by chunk: its first pass keeps what every chunk began with, and each chunk is
// run once more, just before it is reversed.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_LOOPHISTORY_H
#define TAI_AD_LOOPHISTORY_H

#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "tai/AD/AdjointBuilder.h"
#include "tai/Analysis/CarriedValues.h"

namespace mlir::tai {

class LoopHistory {
public:
  /// `count` is the number of iterations, an index of the frame around.
  LoopHistory(AdjointBuilder &builder, scf::ForOp loop, Value count);
  /// Counts the iterations of a loop of unknown length, by running it.
  LoopHistory(AdjointBuilder &builder, scf::WhileOp loop);

  Value getCount() { return count; }

  /// Creates the loop over the iterations, without a terminator.
  scf::ForOp createReverse(ValueRange inits);
  /// Tells the frame of an iteration which one it is.
  void beginIteration(Frame &frame);
  /// Tells the frame of the condition that ends an `scf.while` that it does.
  void beginLast(Frame &frame);
  /// To be called in the frame of the iteration, when its sweep is done.
  void endIteration();
  /// Completes the reverse with the adjoints of captured values as additional
  /// carried values, and hands their sums on. Returns the results for the given
  /// initial values.
  ResultRange close(ArrayRef<Value> yields,
                    const llvm::MapVector<Value, Value> &captured);

  /// The value that carried value `index` has when the iteration of `frame`
  /// begins. Null after an error.
  Value getCarried(Frame &frame, unsigned index);

private:
  struct Chunks {
    /// Iterations in each but the last; null if there is one chunk for sure.
    Value size;
    Value number;
    /// Iterations in the longest.
    Value room;
  };

  scf::WhileOp createCopy(bool counted);
  scf::ForOp getForward();
  Value createClosedForm(Frame &frame, const CarriedValue &value,
                         unsigned index);
  Value createInverse(Frame &frame, const CarriedValue &value);
  Value createRecorded(Frame &frame, unsigned index);
  Value getNext(unsigned index);
  Value getEarly(Frame &frame, Value value);
  BlockArgument getArgument(unsigned index) const;

  Chunks createChunks();
  void record();
  void recordChunks();
  Value getStart(unsigned index, Value chunk);
  void storeRecorded(scf::ForOp recorder);
  scf::ForOp createReverseChunks(ArrayRef<Value> inits, ArrayRef<Value> yields);
  scf::ForOp finishReverse(scf::ForOp reverse, ArrayRef<Value> yields);
  std::pair<Value, Value> createRange(Value begin, Value end);
  static int64_t getBytes(Type type);
  int64_t getBytesPerIteration();
  llvm::StringRef classify(unsigned index) const;
  void report();

  AdjointBuilder &b;
  Operation *loop;
  Frame *around;
  CarriedValues carried;
  Value count;
  /// The copy of an `scf.while` that counts its iterations.
  scf::WhileOp counted;
  /// The loop that runs the iterations forward and records them, once someone
  /// asked for what only it knows. If there are chunks: the loop over these,
  /// and the one inside.
  scf::ForOp forward, inner;
  Chunks chunks;
  /// What is recorded, by carried value, and what every chunk begins with.
  llvm::SmallMapVector<unsigned, memref::AllocOp, 4> histories;
  llvm::SmallMapVector<unsigned, memref::AllocOp, 4> starts;
  /// The reverse, and in its body the number of the last iteration in the
  /// chunk, that of this one, and that of this one in the loop.
  scf::ForOp draft;
  SmallVector<Value> draftInits;
  Operation *last = nullptr, *local = nullptr, *iteration = nullptr;
  /// The carried values that are carried backwards too: what they were in the
  /// next iteration, and are in this one.
  llvm::SmallMapVector<unsigned, BlockArgument, 2> nexts;
  SmallVector<Value> nextYields;
  llvm::SmallDenseSet<unsigned> closed, inverted;
};

} // namespace mlir::tai

#endif // TAI_AD_LOOPHISTORY_H
