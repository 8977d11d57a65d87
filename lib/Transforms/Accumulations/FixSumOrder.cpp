//===- FixSumOrder.cpp - Kernels of a deterministic context ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Copies the option for a fixed order of sums from the context to the modes of
// kernels, where the plan of reductions reads it.
//
//===----------------------------------------------------------------------===//

#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Dialect/Tai/IR/Modes.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_FIXSUMORDER
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// True if the function is a kernel, or a function with a loop of its own, so
/// that it may contain sums over iterations.
static bool hasLoops(FunctionOpInterface function) {
  if (isa<KernelOp>(function.getOperation()))
    return true;
  WalkResult result =
      function->walk([](ParallelForOp) { return WalkResult::interrupt(); });
  return result.wasInterrupted();
}

namespace {
struct FixSumOrder : tai::impl::FixSumOrderBase<FixSumOrder> {
  using Base::Base;

  void runOnOperation() override {
    for (auto function : getOperation().getOps<FunctionOpInterface>())
      if (hasLoops(function))
        Modes::of(function).inDeterministicContext().setOn(function);
  }
};
} // namespace
