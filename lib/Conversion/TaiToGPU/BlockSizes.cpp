//===- BlockSizes.cpp - Block sizes specified by loops --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A loop may specify its block size on a GPU. The function of the loop passes
// the size to the runtime, and as a limit to the driver's assembler, which then
// limits the registers of a thread so that a whole block fits.
//
//===----------------------------------------------------------------------===//

#include "Reductions/WarpLoop.h"
#include "mlir/Dialect/LLVMIR/NVVMDialect.h"
#include "tai/ABI/DeviceAccesses.h"
#include "tai/Analysis/Reductions/Accumulation.h"
#include "tai/Support/BlockSize.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"
#include "llvm/Support/MathExtras.h"

using namespace mlir;
using namespace mlir::tai;

LogicalResult tai::checkBlockSize(ParallelForOp loop) {
  std::optional<int64_t> size = loop.getBlockDim();
  constexpr int64_t most = runtime::kMostBlockThreads, warp = 32;
  if (!size || loop.getSerialize() ||
      (*size > 0 && *size <= most &&
       (*size % warp == 0 || llvm::isPowerOf2_64(*size))))
    return success();
  return loop.emitOpError("has block_dim ")
         << *size << "; on a GPU it is a multiple of " << warp
         << " or a power of two, and " << most << " at most";
}

void tai::noteSizes(ParallelForOp loop, LLVM::LLVMFuncOp function) {
  std::optional<int64_t> count = getNumIterations(loop);
  if (count && *count < 2 * kWarpSize)
    addPassthrough(function, StringAttr::get(loop.getContext(),
                                             runtime::kFewIterationsAttrName));
  if (loop.getInWarp())
    setBlockSize(function, kWarpSize);
  else if (std::optional<int64_t> size = loop.getBlockDim())
    setBlockSize(function, *size);
}

void tai::limitRegisters(LLVM::LLVMFuncOp function) {
  std::optional<int64_t> size = getBlockSize(function);
  if (!size)
    return;
  auto threads = static_cast<int32_t>(*size);
  function->setAttr(NVVM::NVVMDialect::getMaxntidAttrName(),
                    DenseI32ArrayAttr::get(function.getContext(), threads));
}
