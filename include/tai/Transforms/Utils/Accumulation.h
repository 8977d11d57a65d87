//===- Accumulation.h - What a parallel loop adds up ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Groups the atomic updates of a parallel loop by what they update. Used to
// decide how to do them (`tai-relax-atomics`) and to do it
// (`convert-tai-to-scf`).
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_ACCUMULATION_H
#define TAI_TRANSFORMS_UTILS_ACCUMULATION_H

#include "tai/Transforms/Utils/Accumulate.h"

namespace mlir::tai {

/// Updates of one part of one field.
struct AccumulationGroup {
  const FieldInfo *field;
  /// For each dimension, the index shared by all updates of the group and by
  /// all iterations of the loop; null where it varies.
  SmallVector<Value> fixed;
  SmallVector<AtomicOp> atomics;

  bool isFixed() const {
    return llvm::all_of(fixed, [](Value index) { return bool(index); });
  }
};

/// Groups the given updates, which stand in `loop`, by field and by the indices
/// that do not vary, or by their buffer if they have one. Fails at a field that
/// cannot be lowered.
FailureOr<SmallVector<AccumulationGroup>>
groupAccumulations(ParallelForOp loop, ArrayRef<AtomicOp> atomics,
                   FieldTable &fields);

/// Makes one group of two of one field: what they do not share varies.
void mergeGroups(AccumulationGroup &into, const AccumulationGroup &from);

/// The same element is updated, if the operands are the same.
bool updatesSameComponent(AtomicOp a, AtomicOp b);

/// True if distinct iterations of `loop` reach distinct elements at `indices`.
bool isInjective(ParallelForOp loop, ValueRange indices);

/// How often `op` runs in one iteration of `loop`, assumed where unknown.
double estimateRuns(Operation *op, ParallelForOp loop);

/// Nanoseconds of one iteration of `loop` on one core. LLVM vectorises a loop
/// whose iterations are independent, if it has no loop inside.
double estimateIteration(ParallelForOp loop, bool isIndependent);

/// The number of iterations, where it is constant.
std::optional<int64_t> getNumIterations(ParallelForOp loop);

/// Elements of private memory, and updates, that cost the same: zeroing and
/// adding one element of a buffer against one atomic update. Measured: 0.5 ns
/// against 5 ns.
constexpr double kElementsPerUpdate = 10;

/// The value that changes nothing, for sums of `kind`.
TypedAttr getIdentity(AtomicKind kind, Type type);

/// How partial results of `kind` are combined: differences add up.
AtomicKind getCombiningKind(AtomicKind kind);

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_ACCUMULATION_H
