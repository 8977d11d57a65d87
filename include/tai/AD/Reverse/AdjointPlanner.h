//===- AdjointPlanner.h - Plans reverse mode of a kernel --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Selects primal versions for an adjoint. An adjoint runs on the memory that
// the kernel left behind, or, field by field, on the memory before the launch:
// which version holds the value of a read depends on the writes that may run
// before and after the read. Where neither version does, part of the primal is
// re-executed.
//
// The primal values that an adjoint reads are known only after its rules have
// run. So the first plan assumes no re-execution, which is enough for most
// kernels; `settle` compares the demands of the emitted adjoint with the plan.
// The repetition ends, because a plan only grows, by ops and storages of the
// primal.
//
// See docs/decisions/0026-adjoint-planner.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_REVERSE_ADJOINTPLANNER_H
#define TAI_AD_REVERSE_ADJOINTPLANNER_H

#include "tai/AD/Reverse/AdjointPlan.h"

namespace mlir::tai {

class AdjointPlanner {
public:
  AdjointPlanner(FunctionOpInterface primal, AdjointOf adjointOf,
                 ValueShadows shadows = {}, AdjointOptions options = {})
      : plan(primal, std::move(adjointOf), std::move(shadows), options) {}

  const AdjointPlan &getPlan() const { return plan; }
  void setLocalMemory(LocalMemory local) { plan.local = std::move(local); }

  /// For each storage that the adjoint reads, chooses its contents after the
  /// launch, before the launch, or a second execution of the primal. Fails
  /// after an error at a read whose value cannot be had. True if the emitted
  /// adjoint is valid under the plan; false if the plan has grown, and the
  /// adjoint must be emitted again.
  FailureOr<bool> settle(const PrimalDemands &demands);
  /// True if `settle` failed because different loops of the kernel need
  /// different versions of a field.
  bool needsParts() const { return wantsParts; }

  /// The fields that the adjoint reads as they were before the launch of the
  /// primal.
  ArrayRef<Attribute> getFieldsBefore() const { return before; }
  /// True if the values of these primal stores are still in memory when the
  /// adjoint runs.
  bool findsStored(ArrayRef<Operation *> stores) const;
  /// Sets on an adjoint the attributes that name the versions of fields that it
  /// reads.
  void annotate(FunctionOpInterface adjoint) const;

private:
  LogicalResult checkBefore(ArrayRef<DifferentiableAccessInterface> reads,
                            const PrimalDemands &demands);
  bool chooseRecorded(ArrayRef<DifferentiableAccessInterface> reads);
  LogicalResult chooseVersion(ArrayRef<DifferentiableAccessInterface> reads);
  bool planReexecution(DifferentiableAccessInterface lost,
                       ArrayRef<DifferentiableAccessInterface> reads);

  AdjointPlan plan;
  SmallVector<Attribute> before;
  /// The re-execution planned for the next attempt, and whether it is larger
  /// than the one of this attempt.
  ReexecutionPlan larger;
  bool hasGrown = false, wantsParts = false;
};

/// Reports accesses that the planned adjoint would silently leave out of the
/// derivative, or could not reverse.
LogicalResult verifyReversible(const AdjointPlan &plan);

/// Updates the skip counters (work that an optimisation avoided) of an adjoint.
void countSkips(const AdjointPlan &plan, const PrimalDemands &demands);

} // namespace mlir::tai

#endif // TAI_AD_REVERSE_ADJOINTPLANNER_H
