//===- LowerLaunches.cpp - Launches become calls of the runtime -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "../../Transforms/Utils/IndexMath.h"
#include "../TaiToHost/RuntimeCalls.h"
#include "mlir/Dialect/GPU/IR/GPUDialect.h"
#include "tai/Conversion/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_LOWERLAUNCHES
#include "tai/Conversion/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// The number of a device function: its position among those of its module.
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

static LogicalResult lower(gpu::LaunchFuncOp launch, RuntimeCalls &runtime,
                           ModuleOp module) {
  auto host = launch->getParentOfType<LLVM::LLVMFuncOp>();
  if (!host || host.getNumArguments() == 0)
    return launch.emitOpError("stands in no function of the host that has a "
                              "frame; expects convert-tai-to-gpu to make it");
  FailureOr<int64_t> number = getNumber(launch, module);
  if (failed(number))
    return failure();
  OpBuilder builder(launch);
  Location loc = launch.getLoc();
  IndexMath math(builder, loc);
  ValueRange operands = launch.getKernelOperands();
  Value slots = runtime.null(builder, loc);
  if (!operands.empty())
    slots = emitStackSlots(builder, loc, operands.size());
  for (auto [i, operand] : llvm::enumerate(operands))
    emitSlotStore(builder, loc, operand, emitSlot(builder, loc, slots, i));
  // No blocks: the device alone knows how many iterations there are.
  Value blocks = launch.getGridSizeX(), threads = launch.getBlockSizeX();
  Value iterations = getConstantIntValue(blocks) == 0
                         ? math.constant(-1)
                         : math.mul(blocks, threads);
  runtime.tai_rt_device_launch(builder, loc, host.getArgument(0),
                               runtime.i32(builder, loc, *number),
                               math.toI64(iterations), slots,
                               runtime.i32(builder, loc, operands.size()));
  launch.erase();
  return success();
}

namespace {
struct LowerLaunches : tai::impl::LowerLaunchesBase<LowerLaunches> {
  using Base::Base;

  void runOnOperation() override {
    ModuleOp module = getOperation();
    RuntimeCalls runtime(module);
    SmallVector<gpu::LaunchFuncOp> launches;
    module.walk([&](gpu::LaunchFuncOp launch) { launches.push_back(launch); });
    for (gpu::LaunchFuncOp launch : launches)
      if (failed(lower(launch, runtime, module)))
        return signalPassFailure();
  }
};
} // namespace
