//===- LowerLaunches.cpp - Launches become calls of the runtime -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/GPU/IR/GPUDialect.h"
#include "mlir/IR/PatternMatch.h"
#include "tai/Conversion/Passes.h"
#include "tai/Conversion/TaiToHost/RuntimeCalls.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Transforms/Utils/IndexMath.h"
#include "tai/Transforms/Utils/LowerEach.h"

namespace mlir::tai {
#define GEN_PASS_DEF_LOWERLAUNCHES
#include "tai/Conversion/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// Returns the number of a device function, which is its position in its
/// module.
static FailureOr<int64_t> getNumber(gpu::LaunchFuncOp launch, ModuleOp module) {
  auto kernels =
      module.lookupSymbol<gpu::GPUModuleOp>(launch.getKernelModuleName());
  int64_t number = 0;
  if (kernels)
    for (auto function : kernels.getOps<LLVM::LLVMFuncOp>()) {
      if (!function->hasAttr(gpu::GPUDialect::getKernelFuncAttrName()))
        continue;
      if (function.getSymName() == launch.getKernelName().getValue())
        return number;
      ++number;
    }
  return launch.emitOpError("launches ")
         << launch.getKernel()
         << ", which is no device function of this module";
}

namespace {
struct LowerLaunch final : OpRewritePattern<gpu::LaunchFuncOp> {
  LowerLaunch(ModuleOp module, RuntimeCalls &runtime)
      : OpRewritePattern(module.getContext()), module(module),
        runtime(runtime) {}

  LogicalResult matchAndRewrite(gpu::LaunchFuncOp launch,
                                PatternRewriter &rewriter) const override {
    auto host = launch->getParentOfType<LLVM::LLVMFuncOp>();
    if (!host || host.getNumArguments() == 0)
      return launch.emitOpError("stands in no function of the host that has a "
                                "frame; expects convert-tai-to-gpu to make it");
    FailureOr<int64_t> number = getNumber(launch, module);
    if (failed(number))
      return failure();
    Location loc = launch.getLoc();
    IndexMath math(rewriter, loc);
    ValueRange operands = launch.getKernelOperands();
    Value slots = runtime.null(rewriter, loc);
    if (!operands.empty())
      slots = emitStackSlots(rewriter, loc, operands.size());
    for (auto [i, operand] : llvm::enumerate(operands))
      emitSlotStore(rewriter, loc, operand, emitSlot(rewriter, loc, slots, i));
    // A launch with zero blocks has a number of iterations that only the device
    // knows.
    Value blocks = launch.getGridSizeX(), threads = launch.getBlockSizeX();
    Value iterations = getConstantIntValue(blocks) == 0
                           ? math.constant(-1)
                           : math.mul(blocks, threads);
    runtime.tai_rt_device_launch(rewriter, loc, host.getArgument(0),
                                 runtime.i32(rewriter, loc, *number),
                                 math.toI64(iterations), slots,
                                 runtime.i32(rewriter, loc, operands.size()));
    rewriter.eraseOp(launch);
    return success();
  }

private:
  mutable ModuleOp module;
  RuntimeCalls &runtime;
};

struct LowerLaunches : tai::impl::LowerLaunchesBase<LowerLaunches> {
  using Base::Base;

  void runOnOperation() override {
    RuntimeCalls runtime(getOperation());
    RewritePatternSet patterns(&getContext());
    patterns.add<LowerLaunch>(getOperation(), runtime);
    auto isOwned = [](Operation *op) {
      auto function = op->getParentOfType<FunctionOpInterface>();
      return function && isTaiCode(function);
    };
    if (failed(lowerAll(getOperation(), std::move(patterns), isOwned)))
      signalPassFailure();
  }
};
} // namespace
