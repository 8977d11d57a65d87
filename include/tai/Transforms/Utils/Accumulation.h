//===- Accumulation.h - Accumulations of parallel loops ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Groups the atomic updates of a parallel loop by their targets. Used to choose
// a strategy (`tai-relax-atomics`) and to lower it (`convert-tai-to-scf`).
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_ACCUMULATION_H
#define TAI_TRANSFORMS_UTILS_ACCUMULATION_H

#include "tai/Transforms/Utils/Accumulate.h"

namespace mlir::tai {

/// Updates of one part of one field.
struct AccumulationGroup {
  const FieldInfo *field;
  /// For each dimension, the index that is the same for all updates of the
  /// group and all iterations of the loop; null if it varies.
  SmallVector<Value> fixed;
  SmallVector<AtomicOp> atomics;

  bool isFixed() const {
    return llvm::all_of(fixed, [](Value index) { return bool(index); });
  }
};

/// Groups updates in `loop` by field and invariant indices, or by their buffer
/// if they have one. Fails at a field that cannot be lowered.
FailureOr<SmallVector<AccumulationGroup>>
groupAccumulations(ParallelForOp loop, ArrayRef<AtomicOp> atomics,
                   FieldTable &fields);

/// Merges two groups of one field: an index that differs counts as varying.
void mergeGroups(AccumulationGroup &into, const AccumulationGroup &from);

/// On a device in deterministic mode: the number of elements of the part of the
/// field, and the bytes of an accumulator in fixed point of each.
int64_t getNumAccumulators(const AccumulationGroup &group);
int64_t getAccumulatorBytes(Type scalar);

/// True if both update the same component whenever their indices are equal.
bool updatesSameComponent(AtomicOp a, AtomicOp b);

/// True if distinct iterations of `loop` reach distinct elements at `indices`.
bool isInjective(ParallelForOp loop, ValueRange indices);

/// An estimate of how often `op` runs in one iteration of `loop`.
double estimateRuns(Operation *op, ParallelForOp loop);

/// An estimate, in nanoseconds, of one iteration of `loop` on one core. Assumes
/// that LLVM vectorises an innermost loop with independent iterations.
double estimateIteration(ParallelForOp loop, bool isIndependent);

/// The number of iterations, if constant.
std::optional<int64_t> getNumIterations(ParallelForOp loop);

/// The cost of an atomic update relative to zeroing and adding one element of a
/// private buffer. Measured: 5 ns against 0.5 ns.
constexpr double kElementsPerUpdate = 10;

/// So many terms of f32 for an element of a GPU, added up by warps or blocks,
/// are at most some hundred to some thousand additions in f32. More go to f64.
constexpr int64_t kFewTerms = 1 << 15;

/// The neutral element of `kind`.
TypedAttr getIdentity(AtomicKind kind, Type type);

/// The operation that combines partial results of `kind`: addition for
/// subtraction.
AtomicKind getCombiningKind(AtomicKind kind);

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_ACCUMULATION_H
