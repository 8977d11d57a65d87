//===- VerifyInlinable.cpp - Ops that stop the inliner --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// MLIR's inliner asks the dialect of each op with a region which ops may go
// there. With --allow-unregistered-dialect there may be none to ask, and the
// process ends. Here that is an error.
//
//===----------------------------------------------------------------------===//

#include "mlir/Pass/Pass.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_VERIFYINLINABLE
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;

namespace {
struct VerifyInlinable : tai::impl::VerifyInlinableBase<VerifyInlinable> {
  using Base::Base;

  void runOnOperation() override {
    markAllAnalysesPreserved();
    // A module without tai ops is skipped, because pipelines inline no calls in
    // it.
    if (llvm::none_of(*getOperation().getBody(),
                      [](Operation &op) { return tai::belongsToTai(&op); }))
      return;
    WalkResult result = getOperation().walk([](Operation *op) {
      if (op->getNumRegions() == 0 || op->getDialect())
        return WalkResult::advance();
      op->emitOpError("holds a region, and its dialect is not loaded: calls "
                      "cannot be inlined beside it")
              .attachNote()
          << "load the dialect, or keep the function with this op in a module "
             "of its own";
      return WalkResult::interrupt();
    });
    if (result.wasInterrupted())
      signalPassFailure();
  }
};
} // namespace
