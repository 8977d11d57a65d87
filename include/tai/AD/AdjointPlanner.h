//===- AdjointPlanner.h - Plans reverse mode of a kernel --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Makes the plan of an adjoint. An adjoint runs on the memory that the kernel
// left behind, or, field by field, on what was there before: which version
// holds the value of a read depends on the writes that may come before and
// after it. Where neither version does, the plan grows: part of the primal is
// executed forward again.
//
// Which primal values an adjoint reads is for the rules to say, while it is
// emitted. So the first plan assumes that none needs the primal executed again,
// which most do not; what it turns out to need, `settle` compares with the
// plan. A plan only grows, by ops and storages of the primal.
//
// See docs/decisions/0026-adjoint-planner.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_ADJOINTPLANNER_H
#define TAI_AD_ADJOINTPLANNER_H

#include "tai/AD/AdjointPlan.h"

namespace mlir::tai {

class AdjointPlanner {
public:
  AdjointPlanner(FunctionOpInterface primal, AdjointOf adjointOf,
                 ValueShadows shadows = {}, AdjointOptions options = {})
      : plan(primal, std::move(adjointOf), std::move(shadows), options) {}

  const AdjointPlan &getPlan() const { return plan; }

  /// Chooses the version of each storage that the adjoint reads. Fails after an
  /// error at a read that no version holds the value of. True if the adjoint
  /// that was emitted does what the plan says; false if the plan has grown, and
  /// another one must be emitted.
  FailureOr<bool> settle(const PrimalDemands &demands);
  /// True if `settle` failed because several versions of a field are needed,
  /// and not all by one loop.
  bool needsParts() const { return wantsParts; }

  /// The fields that the adjoint reads as they were before the launch.
  ArrayRef<Attribute> getFieldsBefore() const { return before; }
  /// True if what these stores have stored is there when the adjoint runs.
  bool findsStored(ArrayRef<Operation *> stores) const;
  /// Says on an adjoint what it runs on.
  void annotate(FunctionOpInterface adjoint) const;

private:
  LogicalResult chooseVersion(ArrayRef<DifferentiableAccessInterface> reads);
  bool planReexecution(DifferentiableAccessInterface lost,
                       ArrayRef<DifferentiableAccessInterface> reads);

  AdjointPlan plan;
  SmallVector<Attribute> before;
  /// The plan for the next attempt, and whether it is larger than this one.
  ReexecutionPlan larger;
  bool hasGrown = false, wantsParts = false;
};

/// Reports what the adjoint that is planned would leave out of the derivative
/// in silence, or could not reverse.
LogicalResult verifyReversible(const AdjointPlan &plan);

/// Counts what analyses kept out of an adjoint.
void countSkips(const AdjointPlan &plan, const PrimalDemands &demands);

} // namespace mlir::tai

#endif // TAI_AD_ADJOINTPLANNER_H
