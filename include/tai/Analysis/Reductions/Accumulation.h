//===- Accumulation.h - Accumulations of parallel loops ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Groups the updates of a parallel loop by their targets, and reads how each
// update is done: ReductionPlan.h decides it, and lowerings carry it out.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_REDUCTIONS_ACCUMULATION_H
#define TAI_ANALYSIS_REDUCTIONS_ACCUMULATION_H

#include "tai/Analysis/FieldTable.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// On tai.parallel_for: no iteration accesses memory that another iteration
/// writes, so that LLVM may vectorise without a dependence check.
constexpr llvm::StringLiteral kIndependentAttrName = "tai.independent";

/// The #tai.reduction of an update of memory. Not on tai.atomic, which has an
/// inherent attribute for it. An update without the attribute is atomic.
constexpr llvm::StringLiteral kAccumulateAttrName = "tai.accumulate";

/// Returns how the parallel loop performs an update of memory. Null for an
/// update that the lowering of memory accesses does, as an atomic or a plain
/// access.
ReductionAttr getReduction(Operation *update);
inline bool isDoneByLoop(Operation *update) {
  return getReduction(update) != nullptr;
}
/// True if the lowering keeps the running sum of `update` in a register.
bool isKeptInRegister(Operation *update);

/// Updates of one element, in the order of the program: the loop keeps their
/// sum in one register.
using Total = SmallVector<Operation *>;
SmallVector<Total> groupTotals(ArrayRef<Operation *> updates);
/// The operation that combines partial results of an update, which is an
/// addition for a subtraction, and the type of the combined terms.
AtomicKind getCombiningKind(Operation *update);
Type getTermType(Operation *update);

/// True if `loop` has a sum whose terms are added in the order that is the same
/// on all targets (CPU, GPU and their numbers of threads).
bool hasCommonTotals(ParallelForOp loop);

/// Updates in a loop that all accumulate to the same part of the same field.
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

/// Merges group `from` into group `into`, both of one field. Where their fixed
/// indices differ, the merged index counts as varying.
void mergeGroups(AccumulationGroup &into, const AccumulationGroup &from);

/// For sums in fixed point: the number of accumulators that `group` needs, one
/// for each element of the part of the field; and the size of an accumulator in
/// bytes.
int64_t getNumAccumulators(const AccumulationGroup &group);
int64_t getAccumulatorBytes(Type scalar);

/// True if the updates `a` and `b` reach the same component of an element
/// whenever their indices of the element are equal.
bool updatesSameComponent(AtomicOp a, AtomicOp b);

/// True if distinct iterations of `loop` reach distinct elements by the indices
/// `indices`.
bool isInjective(ParallelForOp loop, ValueRange indices);

/// An estimate of how often `op` runs in one iteration of `loop`.
double estimateRuns(Operation *op, ParallelForOp loop);

/// An estimate, in nanoseconds, of one iteration of `loop` on one core. Assumes
/// that LLVM vectorises an innermost loop with independent iterations.
double estimateIteration(ParallelForOp loop, bool isIndependent);

/// The number of iterations of `loop` if it is constant; no value otherwise.
std::optional<int64_t> getNumIterations(ParallelForOp loop);

/// The cost of an atomic update relative to zeroing and adding one element of a
/// private buffer. Measured: 5 ns against 0.5 ns.
constexpr double kElementsPerUpdate = 10;

/// The most f32 terms that a GPU adds in f32 to one element: warps or blocks
/// add the terms, in some hundred to some thousand additions in f32. Sums of
/// more terms are in f64.
constexpr int64_t kFewTerms = 1 << 15;

/// The neutral element of updates of `kind`, such as 0 for additions.
TypedAttr getIdentity(AtomicKind kind, Type type);

/// The operation that combines partial results of updates of `kind`: `kind`
/// itself, but addition for subtraction.
AtomicKind getCombiningKind(AtomicKind kind);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_REDUCTIONS_ACCUMULATION_H
