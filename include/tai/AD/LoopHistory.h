//===- LoopHistory.h - Loop-carried values, in reverse ----------*- C++ -*-===//
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
// second run of the loop, if a rule asks for them: see LoopTrajectory.h.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_LOOPHISTORY_H
#define TAI_AD_LOOPHISTORY_H

#include "tai/AD/LoopTrajectory.h"
#include "tai/Analysis/CarriedValues.h"

namespace mlir::tai {
struct ReversedLoop;

class LoopHistory {
public:
  /// `count` is the number of iterations, an index of the frame around.
  LoopHistory(AdjointBuilder &builder, scf::ForOp loop, Value count);
  /// Counts the iterations of a loop of unknown length, by running it.
  LoopHistory(AdjointBuilder &builder, scf::WhileOp loop);

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
  scf::WhileOp createCopy(bool counted);
  scf::ForOp getForward();
  Value createClosedForm(Frame &frame, const CarriedValue &value,
                         unsigned index);
  Value createInverse(Frame &frame, const CarriedValue &value);
  Value getNext(unsigned index);
  Value getEarly(Frame &frame, Value value);
  BlockArgument getArgument(unsigned index) const;
  llvm::StringRef classify(unsigned index) const;
  ReversedLoop summarize();

  AdjointBuilder &b;
  Operation *loop;
  Frame &around;
  CarriedValues carried;
  Value count;
  /// The copy of an `scf.while` that counts its iterations.
  scf::WhileOp counted;
  /// The loop that runs the iterations forward again, once someone asked for
  /// what only it knows.
  scf::ForOp forward;
  LoopTrajectory trajectory;
  ReverseDraft draft;
  /// The carried values that are carried backwards too: what they were in the
  /// next iteration, and are in this one.
  llvm::SmallMapVector<unsigned, BlockArgument, 2> nexts;
  SmallVector<Value> nextYields;
  llvm::SmallDenseSet<unsigned> closed, inverted;
};

} // namespace mlir::tai

#endif // TAI_AD_LOOPHISTORY_H
