//===- RelaxAtomics.cpp - Carries out the plan of reductions --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Writes the plan of each parallel loop to its updates, as attributes that
// lowerings read, and reports it.
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/Remarks.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "mlir/Transforms/LoopInvariantCodeMotionUtils.h"
#include "tai/Analysis/FieldTable.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_RELAXATOMICS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// Emits a remark for each update of the loop: its form, the digits of its sum
/// and the order of the terms, or the reason why it stays atomic.
static void report(ParallelForOp loop, const ReductionPlan &plan) {
  if (!loop.getContext()->getRemarkEngine())
    return;
  auto function = loop->getParentOfType<FunctionOpInterface>();
  for (const auto &[op, update] : plan.updates) {
    ReductionAttr reduction = update.reduction;
    StringRef form = reduction ? stringifyReductionForm(reduction.getForm())
                     : plan.isSerial      ? "serial"
                     : update.isExclusive ? "exclusive"
                     : plan.inWarp        ? "warp"
                                          : "atomic";
    auto options = remark::RemarkOpts::name(form)
                       .category("tai-reductions")
                       .function(function ? function.getName() : "");
    auto remark = form == "atomic" ? remark::missed(op->getLoc(), options)
                                   : remark::passed(op->getLoc(), options);
    if (auto atomic = dyn_cast<AtomicOp>(op))
      remark << remark::metric("Field", atomic.getField().str());
    if (reduction)
      remark << remark::metric("Digits",
                               stringifySumDigits(reduction.getDigits()).str())
             << remark::metric(
                    "Order",
                    stringifyReductionOrder(reduction.getOrder()).str());
    if (form == "atomic")
      remark << remark::metric("Reason", update.reason.str());
  }
}

namespace {
struct RelaxAtomics : tai::impl::RelaxAtomicsBase<RelaxAtomics> {
  using Base::Base;

  void runOnOperation() override {
    Operation *table = SymbolTable::getNearestSymbolTable(getOperation());
    if (!table)
      return;
    FieldTable fields(table);
    SmallVector<ParallelForOp> loops;
    getOperation()->walk([&](Operation *op) {
      if (auto loop = dyn_cast<ParallelForOp>(op))
        loops.push_back(loop);
      // Serial code of a kernel runs on one thread, so its updates need not be
      // atomic.
      auto atomic = dyn_cast<AtomicOp>(op);
      if (atomic && !op->getParentOfType<ParallelForOp>())
        atomic.setExclusive(true);
    });
    for (ParallelForOp loop : loops) {
      if (!loop.getSerialize())
        moveLoopInvariantCode(cast<LoopLikeOpInterface>(loop.getOperation()));
      FailureOr<ReductionPlan> plan = planReductions(loop, fields, onDevice);
      if (failed(plan))
        return signalPassFailure();
      report(loop, *plan);
      plan->apply(loop);
    }
  }
};
} // namespace
