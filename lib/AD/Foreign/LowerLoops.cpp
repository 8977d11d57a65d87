//===- LowerLoops.cpp - Loops without a derivative of their own -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A loop with unsigned bounds counts from zero instead, and the threads of a
// `gpu.launch` become the iterations of a parallel loop, which upstream's
// passes can map to a GPU again.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/GPU/IR/GPUDialect.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/IR/Matchers.h"
#include "tai/AD/Foreign/Foreign.h"

using namespace mlir;
using namespace mlir::tai;

/// The number of iterations, in the type of the bounds.
static Value countIterations(ImplicitLocOpBuilder &b, scf::ForOp loop) {
  Type type = loop.getInductionVar().getType();
  Value zero = arith::ConstantOp::create(b, b.getIntegerAttr(type, 0));
  Value one = arith::ConstantOp::create(b, b.getIntegerAttr(type, 1));
  Value lower = loop.getLowerBound(), upper = loop.getUpperBound();
  Value runs =
      arith::CmpIOp::create(b, arith::CmpIPredicate::ugt, upper, lower);
  Value span = arith::SubIOp::create(b, upper, lower);
  Value last = arith::DivUIOp::create(b, arith::SubIOp::create(b, span, one),
                                      loop.getStep());
  return arith::SelectOp::create(b, runs, arith::AddIOp::create(b, last, one),
                                 zero);
}

static void countFromZero(scf::ForOp loop) {
  ImplicitLocOpBuilder b(loop.getLoc(), loop);
  Type type = loop.getInductionVar().getType();
  Value count = countIterations(b, loop);
  if (!type.isIndex())
    count = arith::IndexCastUIOp::create(b, b.getIndexType(), count);
  auto counted = scf::ForOp::create(b, arith::ConstantIndexOp::create(b, 0),
                                    count, arith::ConstantIndexOp::create(b, 1),
                                    loop.getInitArgs());
  counted.getRegion().takeBody(loop.getRegion());
  BlockArgument number = counted.getBody()->getArgument(0);
  number.setType(b.getIndexType());
  b.setInsertionPointToStart(counted.getBody());
  Value factor = number;
  if (!type.isIndex())
    factor = arith::IndexCastUIOp::create(b, type, number);
  Value offset = arith::MulIOp::create(b, factor, loop.getStep());
  Value index = arith::AddIOp::create(b, loop.getLowerBound(), offset);
  number.replaceAllUsesExcept(index, type.isIndex() ? offset.getDefiningOp()
                                                    : factor.getDefiningOp());
  loop.replaceAllUsesWith(counted.getResults());
  loop.erase();
}

/// True if threads do not communicate but through memory from outside.
static bool isPlain(gpu::LaunchOp launch) {
  if (!launch.getBody().hasOneBlock() || launch.hasClusterSize() ||
      launch.getAsyncToken() || !launch.getAsyncDependencies().empty() ||
      launch.getNumWorkgroupAttributions() != 0 ||
      launch.getNumPrivateAttributions() != 0 ||
      launch.getDynamicSharedMemorySize())
    return false;
  bool isPlain = true;
  launch.getBody().walk([&](Operation *op) {
    isPlain &= isa<gpu::TerminatorOp>(op) ||
               !isa_and_present<gpu::GPUDialect>(op->getDialect());
  });
  return isPlain;
}

static void runInParallel(gpu::LaunchOp launch) {
  ImplicitLocOpBuilder b(launch.getLoc(), launch);
  gpu::KernelDim3 grid = launch.getGridSizeOperandValues();
  gpu::KernelDim3 block = launch.getBlockSizeOperandValues();
  gpu::KernelDim3 blockId = launch.getBlockIds(),
                  thread = launch.getThreadIds();
  gpu::KernelDim3 gridSize = launch.getGridSize(),
                  blockSize = launch.getBlockSize();
  Value sizes[] = {grid.x, grid.y, grid.z, block.x, block.y, block.z};
  Value ids[] = {blockId.x, blockId.y, blockId.z, thread.x, thread.y, thread.z};
  Value dims[] = {gridSize.x,  gridSize.y,  gridSize.z,
                  blockSize.x, blockSize.y, blockSize.z};
  Value zero = arith::ConstantIndexOp::create(b, 0);
  Value one = arith::ConstantIndexOp::create(b, 1);
  SmallVector<Value> uppers, counted;
  for (auto [size, id, dim] : llvm::zip(sizes, ids, dims)) {
    dim.replaceAllUsesWith(size);
    if (matchPattern(size, m_One())) {
      id.replaceAllUsesWith(zero);
      continue;
    }
    uppers.push_back(size);
    counted.push_back(id);
  }
  if (uppers.empty()) {
    // One thread: its ops take the place of the launch.
    Block &body = launch.getBody().front();
    launch->getBlock()->getOperations().splice(
        launch->getIterator(), body.getOperations(), body.begin(),
        body.getTerminator()->getIterator());
    launch.erase();
    return;
  }
  SmallVector<Value> lowers(uppers.size(), zero), steps(uppers.size(), one);
  auto loop = scf::ParallelOp::create(b, lowers, uppers, steps);
  for (auto [id, iv] : llvm::zip(counted, loop.getInductionVars()))
    id.replaceAllUsesWith(iv);
  Block &body = launch.getBody().front();
  loop.getBody()->getOperations().splice(
      loop.getBody()->getTerminator()->getIterator(), body.getOperations(),
      body.begin(), body.getTerminator()->getIterator());
  launch.erase();
}

void mlir::tai::lowerLoops(func::FuncOp function) {
  SmallVector<scf::ForOp> loops;
  SmallVector<gpu::LaunchOp> launches;
  function.walk([&](Operation *op) {
    if (auto loop = dyn_cast<scf::ForOp>(op); loop && loop.getUnsignedCmp())
      loops.push_back(loop);
    else if (auto launch = dyn_cast<gpu::LaunchOp>(op);
             launch && isPlain(launch))
      launches.push_back(launch);
  });
  llvm::for_each(loops, countFromZero);
  llvm::for_each(launches, runInParallel);
}
