//===- Accumulators.h - Partial sums of a parallel loop ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Lowers the accumulations that `tai-relax-atomics` has privatised: each
// partition sums in registers and in private buffers, and the kernel adds the
// partial sums to the fields after the loop, in the order of the partitions.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CONVERSION_TAITOHOST_REDUCTIONS_ACCUMULATORS_H
#define TAI_CONVERSION_TAITOHOST_REDUCTIONS_ACCUMULATORS_H

#include "tai/Conversion/TaiToHost/Lowering.h"
#include "tai/Conversion/TaiToHost/Reductions/BufferSums.h"
#include "tai/Conversion/TaiToHost/Reductions/TotalForm.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"
#include <optional>
#include <vector>

namespace mlir::tai {

class Accumulators {
public:
  /// Collects the accumulations of `loop` that each partition does in private
  /// memory or registers.
  static FailureOr<Accumulators> collect(ParallelForOp loop,
                                         ModuleLowering &lowering);

  bool empty() const { return registers.empty() && buffers.empty(); }

  /// Emits the number of partitions for which private buffers are worth their
  /// cost, at most `parts`.
  Value limitParts(OpBuilder &builder, Location loc, Value parts, Value count,
                   double iterationsPerCount);

  /// Emits code in the kernel, before the loop, that allocates the partial
  /// sums.
  void emitBefore(OpBuilder &builder, Location loc, Value frame, Value parts);

  /// Emits code at the entry of the loop's function, where the partition is
  /// known.
  void emitEntry(OpBuilder &builder, Location loc, Value part);
  /// Replaces the updates by updates of private sums, after the loop's body has
  /// been moved into its function.
  void rewriteUpdates();
  /// The maximum number of iterations in a block of the innermost loop, after
  /// which sums are added to totals; or 0 if no sum needs blocks.
  int64_t getBlockLength() const;
  /// True if the limit getBlockLength() is strict, so that it also cuts rows of
  /// iterations (along the last dimension).
  bool storesTerms() const;
  /// Emits code after each block of iterations that `loop` runs: adds the sums
  /// of the block to the totals.
  void emitBlockEnd(OpBuilder &builder, Location loc, scf::ForOp loop);
  /// Emits the end of the loop's function, which stores the partial sums of the
  /// partition.
  void emitExit(OpBuilder &builder, Location loc);

  /// For a loop whose iterations are cut into chunks, so that its sums have the
  /// order of all targets: emit code before and after the iterations of a
  /// chunk.
  void emitChunkStart(OpBuilder &builder, Location loc);
  void emitChunkEnd(OpBuilder &builder, Location loc, Value chunk);
  /// Makes iteration i of `loop` add to lane i - `base` of the sums.
  void setLanes(scf::ForOp loop, Value base) { innermost = {loop, base}; }

  /// Emits code in the kernel after the loop that adds the partial sums to the
  /// fields.
  void emitAfter(OpBuilder &builder, Location loc, Value frame, Value parts);
  /// Emits the code after the loop, like emitAfter, for the partial sums of
  /// `chunks` chunks of iterations.
  void emitAfterChunks(OpBuilder &builder, Location loc, Value chunks);

private:
  /// The sum of one component that a partition keeps in a register.
  struct Register {
    Register(const FieldInfo *field, Total updates);

    /// The field to which the sum is added; null for an array of the kernel.
    const FieldInfo *field;
    Total updates;
    std::unique_ptr<TotalForm> form;
    // The place of the sum in a field, or its address in an array, as values of
    // the kernel. Not taken from the updates, whose operands change when the
    // loop becomes a function.
    SmallVector<Value> indices, components;
    Value address;
  };

  explicit Accumulators(ModuleLowering &lowering) : lowering(&lowering) {}
  void emitTotal(OpBuilder &builder, Location loc, const Register &sum,
                 ValueRange total);
  int64_t getPartialSlot(size_t i) const;
  int64_t getPartialBytes() const;

  ModuleLowering *lowering;
  std::vector<Register> registers;
  std::vector<BufferSums> buffers;
  /// The innermost loop in the loop's function, and the iteration of its first
  /// lane.
  TotalForm::Place innermost;
  /// Memory for the register sums of all partitions, in the kernel.
  Value partials;
  Value insidePartials;
};

/// Lowers an update in serial code to a load and a store.
LogicalResult lowerNonAtomic(AtomicOp atomic, FieldTable &fields);

} // namespace mlir::tai

#endif // TAI_CONVERSION_TAITOHOST_REDUCTIONS_ACCUMULATORS_H
