//===- HoistAllocations.cpp - One buffer for all iterations ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The adjoint of an iteration records the history of its loops in memory that
// it allocates and frees, which costs as much as a short loop. A partition of a
// parallel loop is a loop at this stage, and each thread that runs one has its
// own memory.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Transforms/LoopInvariantCodeMotionUtils.h"
#include "tai/ABI/LocalMemory.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_HOISTALLOCATIONS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// True for an allocation on the host or on a device.
static bool isAllocation(Operation *op) {
  auto call = dyn_cast<LLVM::CallOp>(op);
  return call &&
         (call.getCallee() == "malloc" || call.getCallee() == kLocalAllocate);
}
static bool isFree(Operation *op) {
  auto call = dyn_cast<LLVM::CallOp>(op);
  return call && (call.getCallee() == "free" || call.getCallee() == kLocalFree);
}

/// Returns the op that frees the memory at the end of the same iteration that
/// allocates it, or null.
static Operation *findFree(LLVM::CallOp allocation) {
  Operation *found = nullptr;
  for (Operation *user : allocation.getResult().getUsers()) {
    if (!isFree(user))
      continue;
    if (found || user->getBlock() != allocation->getBlock())
      return nullptr;
    found = user;
  }
  return found;
}

namespace {
struct HoistAllocations : tai::impl::HoistAllocationsBase<HoistAllocations> {
  using Base::Base;

  void runOnOperation() override {
    // Inner loops come first, because an allocation that leaves an inner loop
    // may leave the next loop as well.
    walkOwned(getOperation(), [](Operation *owned) {
      owned->walk<WalkOrder::PostOrder>(
          [](scf::ForOp loop) { hoistFrom(loop); });
    });
  }

  static void hoistFrom(scf::ForOp loop) {
    SmallVector<std::pair<LLVM::CallOp, Operation *>> pairs;
    for (Operation &op : *loop.getBody()) {
      if (!isAllocation(&op))
        continue;
      auto allocation = cast<LLVM::CallOp>(op);
      if (Operation *release = findFree(allocation))
        pairs.push_back({allocation, release});
    }
    if (pairs.empty())
      return;
    moveLoopInvariantCode(loop); // the sizes
    for (auto [allocation, release] : pairs)
      if (llvm::all_of(allocation.getArgOperands(), [&](Value argument) {
            return loop.isDefinedOutsideOfLoop(argument);
          })) {
        allocation->moveBefore(loop);
        release->moveAfter(loop);
      }
  }
};
} // namespace
