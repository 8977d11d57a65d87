//===- LoopHistory.h - Loop-carried values, in reverse ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The reverse of a serial loop, while it is being built: the loop over the
// iterations from last to first, and how each of them recovers the carried
// values with which the primal iteration began.
//
// A value with a closed form in the iteration number is computed; a value with
// an exact inverse is carried backwards. Other values are recorded by a second
// run of the loop, if a rule needs them: see LoopTrajectory.h.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_REVERSE_LOOPHISTORY_H
#define TAI_AD_REVERSE_LOOPHISTORY_H

#include "tai/AD/Reverse/LoopTrajectory.h"
#include "tai/Analysis/CarriedValues.h"

namespace mlir::tai {
struct ReversedLoop;

class LoopHistory {
public:
  /// Starts the reverse of `loop`. `count` is its number of iterations, an
  /// index value of the enclosing frame.
  LoopHistory(AdjointBuilder &builder, scf::ForOp loop, Value count);
  /// Counts the iterations of a loop of unknown length, by running it.
  LoopHistory(AdjointBuilder &builder, scf::WhileOp loop);

  /// Creates the loop that runs the iterations in reverse, without a
  /// terminator.
  scf::ForOp createReverse(ValueRange inits);
  /// Computes the iteration number of the primal loop in the frame of one
  /// reversed iteration.
  void beginIteration(Frame &frame);
  /// Marks the frame of the last evaluation of an `scf.while`'s condition,
  /// which exits the loop.
  void beginLast(Frame &frame);
  /// Completes a reversed iteration. Must be called in the frame of the
  /// iteration, after its sweep.
  void endIteration();
  /// Completes the reverse loop. The adjoints of captured values become
  /// additional carried values, and their sums are added to the adjoints in the
  /// enclosing frame. Returns the results that belong to the given initial
  /// values.
  ResultRange close(ArrayRef<Value> yields,
                    const llvm::MapVector<Value, Value> &captured);

  /// The value that carried value number `index` has at the start of the primal
  /// iteration of `frame`. Null after an error.
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
  /// The copy of an `scf.while` that counts the iterations of that loop.
  scf::WhileOp counted;
  /// The loop that re-runs the iterations forward; created when a recorded
  /// value is first needed.
  scf::ForOp forward;
  LoopTrajectory trajectory;
  ReverseDraft draft;
  /// The carried values that the reverse loop carries too, because they have an
  /// exact inverse: their values at the start of the next primal iteration, and
  /// of this one.
  llvm::SmallMapVector<unsigned, BlockArgument, 2> nexts;
  SmallVector<Value> nextYields;
  llvm::SmallDenseSet<unsigned> closed, inverted;
};

} // namespace mlir::tai

#endif // TAI_AD_REVERSE_LOOPHISTORY_H
