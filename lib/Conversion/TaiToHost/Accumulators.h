//===- Accumulators.h - Partial sums of a parallel loop ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Does the accumulations that `tai-relax-atomics` took out of memory: each
// partition sums in registers and in buffers of its own, and the kernel adds
// the partial sums to the fields afterwards, in the order of the partitions.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOHOST_ACCUMULATORS_H
#define TAI_LIB_CONVERSION_TAITOHOST_ACCUMULATORS_H

#include "LaneSums.h"
#include "Lowering.h"
#include "PairSums.h"
#include "tai/Transforms/Utils/Accumulation.h"
#include <optional>
#include <vector>

namespace mlir::tai {

class Accumulators {
public:
  /// Iterations whose sums are added up apart: few enough that their sum in the
  /// type itself is good, and so many that adding the sums of a vector's lanes
  /// up is not seen.
  static constexpr int64_t kBlock = 2048;
  /// The same where WidenSums keeps them in f64: where all updates are made by
  /// the innermost loop itself.
  static constexpr int64_t kWidenedBlock = 8192;

  /// Collects the accumulations of `loop`.
  static FailureOr<Accumulators> collect(ParallelForOp loop,
                                         ModuleLowering &lowering);

  bool empty() const { return registers.empty() && buffers.empty(); }

  /// The number of partitions that pays for the buffers, at most `parts`.
  Value limitParts(OpBuilder &builder, Location loc, Value parts, Value count,
                   double iterationsPerCount);

  /// In the kernel, before the loop: makes room for partial sums.
  void emitBefore(OpBuilder &builder, Location loc, Value frame, Value parts);

  /// In the function of the loop, before its loops, at the place where the
  /// partition is known.
  void emitEntry(OpBuilder &builder, Location loc, Value part);
  /// Replaces the updates, once they have been moved into the function.
  void rewriteUpdates();
  /// The iterations of a block of the innermost loop, at most, where there are
  /// sums that want such blocks: 0 where there are none.
  int64_t getBlockLength() const;
  /// Whether blocks must not be longer than that, in loops over rows, too.
  bool keepsTerms() const;
  /// After each block of iterations, which `loop` runs: adds its sums to those
  /// of the blocks.
  void emitBlockEnd(OpBuilder &builder, Location loc, scf::ForOp loop);
  /// After the loops.
  void emitExit(OpBuilder &builder, Location loc);

  /// In the function of a loop that is cut into chunks, because of sums in the
  /// order of all targets: around the iterations of a chunk.
  void emitChunkStart(OpBuilder &builder, Location loc);
  void emitChunkEnd(OpBuilder &builder, Location loc, Value chunk);
  /// Of these sums, iteration i of `loop` belongs to lane i - `base`.
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
    Register(const FieldInfo *field, SmallVector<AtomicOp> atomics,
             AtomicKind kind, Type type, SmallVector<Value> indices,
             SmallVector<Value> components);
    /// Sums blocks of iterations apart, where these are floats.
    void sumInBlocks();
    SmallVector<Operation *> getUpdates() const;

    const FieldInfo *field;
    SmallVector<AtomicOp> atomics;
    AtomicKind kind; // how partial sums are combined
    /// Of the sum over a block, and of the sum of blocks and of partitions.
    Type type, totalType;
    bool isBlocked = false;
    /// What the sum rounds away is summed beside it: compensated sums of f64.
    bool isPair = false;
    /// Added to the field in `totalType`, and rounded once.
    bool isCompensated = false;
    // In the kernel:
    SmallVector<Value> indices, components;
    /// Where a local sum goes, which is of no field.
    Value address;
    SmallVector<LLVM::AtomicRMWOp> updates;
    Type localType;
    // In the function of the loop: of the block, and of those before it; what a
    // pair has rounded away.
    Value slot, total, rest;
    /// Of a pair whose terms are kept for a block of iterations.
    bool keepsTerms = false;
    std::optional<PairLanes> lanes;
    /// Of sums in the order of all targets.
    std::optional<LaneSum> ordered;
  };
  /// Sums of a part of a field in a buffer.
  struct Buffer {
    AccumulationGroup group;
    FieldSlice slice;
    double updatesPerIteration;
    /// Sums in f64 of a field of f32, in a buffer of every partition.
    bool isWide = false;
    /// Pairs of f64, for compensated sums of f64: also in all partitions.
    bool isPair = false;
    // In the kernel:
    Value target, memory, partStride, cellStride;
    // In the function of the loop:
    Value base;

    int64_t numElements() const {
      return slice.numCells * group.field->numComponents;
    }
    /// Bytes of a number in the buffer.
    int64_t scalarSize() const {
      if (isPair)
        return 2 * int64_t(sizeof(double));
      return isWide ? int64_t(sizeof(double)) : group.field->scalarSize;
    }
    /// Whether no partition updates the field itself.
    bool isApart() const { return isWide || isPair; }
    int64_t compactStride() const {
      return group.field->numComponents * group.field->scalarSize;
    }
    bool isContiguous() const { return slice.cellStride == compactStride(); }
  };

  explicit Accumulators(ModuleLowering &lowering) : lowering(&lowering) {}
  /// Sums in arrays that the kernel makes for them.
  void collectLocalSums(ParallelForOp loop);
  Value emitTarget(OpBuilder &builder, Location loc, const Buffer &buffer);
  void emitBlockSums(OpBuilder &builder, Location loc);
  void emitTotal(OpBuilder &builder, Location loc, const Register &sum,
                 Pair total);
  int64_t getPartialSlot(size_t i) const;
  int64_t getPartialBytes() const;

  ModuleLowering *lowering;
  /// Of sums that are not compensated.
  int64_t blockLength = kBlock;
  /// Whether sums are kept with twice the digits of their type.
  bool compensated = false;
  /// Whether LLVM may not reorder the sums.
  bool keepsOrder = false;
  std::vector<Register> registers;
  std::vector<Buffer> buffers;
  /// The innermost loop, in the function, and its iteration of the first lane.
  scf::ForOp innermost;
  Value laneBase;
  /// Room for the registers of all partitions, in the kernel.
  Value partials;
  Value insidePartials;
};

/// Does an update where only one thread runs.
LogicalResult lowerPlainly(AtomicOp atomic, FieldTable &fields);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOHOST_ACCUMULATORS_H
