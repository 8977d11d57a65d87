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

#ifndef TAI_LIB_CONVERSION_TAITOHOST_ACCUMULATORS_H
#define TAI_LIB_CONVERSION_TAITOHOST_ACCUMULATORS_H

#include "LaneSums.h"
#include "Lowering.h"
#include "PairSums.h"
#include "tai/Transforms/Utils/Accumulate.h"
#include <optional>
#include <vector>

namespace mlir::tai {

class Accumulators {
public:
  /// Collects the accumulations of `loop`.
  static FailureOr<Accumulators> collect(ParallelForOp loop,
                                         ModuleLowering &lowering);

  bool empty() const { return registers.empty() && buffers.empty(); }

  /// The number of partitions for which buffers are worth their cost, at most
  /// `parts`.
  Value limitParts(OpBuilder &builder, Location loc, Value parts, Value count,
                   double iterationsPerCount);

  /// In the kernel, before the loop: allocates partial sums.
  void emitBefore(OpBuilder &builder, Location loc, Value frame, Value parts);

  /// In the outlined function, before its loops, where the partition is known.
  void emitEntry(OpBuilder &builder, Location loc, Value part);
  /// Replaces the updates, after they have been moved into the function.
  void rewriteUpdates();
  /// The maximum number of iterations in a block of the innermost loop, or 0 if
  /// no sum needs blocks.
  int64_t getBlockLength() const;
  /// Whether that limit is strict, in loops over rows, too.
  bool storesTerms() const;
  /// After each block of iterations, run by `loop`: adds its sums to the
  /// totals.
  void emitBlockEnd(OpBuilder &builder, Location loc, scf::ForOp loop);
  /// After the loops.
  void emitExit(OpBuilder &builder, Location loc);

  /// In the function of a loop that is cut into chunks, because of sums in the
  /// order of all targets: around the iterations of a chunk.
  void emitChunkStart(OpBuilder &builder, Location loc);
  void emitChunkEnd(OpBuilder &builder, Location loc, Value chunk);
  /// Iteration i of `loop` belongs to lane i - `base` of these sums.
  void setLanes(scf::ForOp loop, Value base) {
    innermost = loop;
    laneBase = base;
  }

  /// In the kernel, after the loop: adds the partial sums to the fields.
  void emitAfter(OpBuilder &builder, Location loc, Value frame, Value parts);
  /// The same for the groups of `chunks`.
  void emitAfterChunks(OpBuilder &builder, Location loc, Value chunks);

private:
  /// A sum of one component in a register.
  struct Register {
    /// `field` is null for a sum in an array of the kernel.
    Register(const FieldInfo *field, Total updates);

    const FieldInfo *field;
    Total updates;
    ReductionAttr reduction;
    AtomicKind kind; // how partial sums are combined
    /// The type of the terms, of the sum over a block, and of the totals over
    /// blocks and partitions.
    Type termType, type, totalType;
    // In the kernel: the place in a field, or the address in an array. The
    // operands of the updates change when their loop becomes a function.
    SmallVector<Value> indices, components;
    Value address;
    // In the outlined function: the sum of the block, the total of earlier
    // blocks, and the rounding error of a pair.
    Value slot, total, rest;
    /// For blocks of terms.
    std::optional<PairLanes> lanes;
    /// For sums in the order of all targets.
    std::optional<LaneSum> ordered;

    bool isPair() const { return reduction.getDigits() == SumDigits::Pair; }
    bool isBlocked() const { return reduction.getBlock() != 0 && !isPair(); }
    bool storesTerms() const { return reduction.getBlock() != 0 && isPair(); }
  };
  /// Sums of a part of a field in a buffer.
  struct Buffer {
    AccumulationGroup group;
    FieldSlice slice;
    double updatesPerIteration = 0;
    /// For `Wide` and `Pair` every partition has a buffer.
    SumDigits digits = SumDigits::Own;
    // In the kernel:
    Value target, memory, partStride, cellStride;
    // In the function of the loop:
    Value base;

    int64_t numElements() const {
      return slice.numCells * group.field->numComponents;
    }
    /// Bytes of a number in the buffer.
    int64_t scalarSize() const {
      switch (digits) {
      case SumDigits::Own:
        return group.field->scalarSize;
      case SumDigits::Wide:
        return sizeof(double);
      case SumDigits::Pair:
        return 2 * sizeof(double);
      }
      llvm_unreachable("unknown digits");
    }
    /// Whether every partition has a buffer, so that none updates the field
    /// itself.
    bool isApart() const { return digits != SumDigits::Own; }
    bool isPair() const { return digits == SumDigits::Pair; }
    int64_t compactStride() const {
      return group.field->numComponents * group.field->scalarSize;
    }
    bool isContiguous() const { return slice.cellStride == compactStride(); }
  };

  explicit Accumulators(ModuleLowering &lowering) : lowering(&lowering) {}
  Value emitTarget(OpBuilder &builder, Location loc, const Buffer &buffer);
  void emitBlockSums(OpBuilder &builder, Location loc);
  void emitTotal(OpBuilder &builder, Location loc, const Register &sum,
                 Pair total);
  int64_t getPartialSlot(size_t i) const;
  int64_t getPartialBytes() const;

  ModuleLowering *lowering;
  std::vector<Register> registers;
  std::vector<Buffer> buffers;
  /// The innermost loop, in the function, and its iteration of the first lane.
  scf::ForOp innermost;
  Value laneBase;
  /// Memory for the register sums of all partitions, in the kernel.
  Value partials;
  Value insidePartials;
};

/// Lowers an update in serial code, without an atomic.
LogicalResult lowerNonAtomic(AtomicOp atomic, FieldTable &fields);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOHOST_ACCUMULATORS_H
