//===- Vectorization.cpp - Limits of LLVM's vectorisation -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Transforms/Utils/Vectorization.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

bool mlir::tai::mayBeVectorized(Block &block) {
  Operation *loop = block.getParentOp();
  while (loop && !isa<LoopLikeOpInterface>(loop))
    loop = loop->getParentOp();
  if (!isa_and_nonnull<ParallelForOp>(loop))
    return false;
  // A loop stays scalar if its body contains inner loops, atomics or small
  // dense algebra.
  return !loop->walk([&](Operation *op) {
                if (op != loop && isa<LoopLikeOpInterface>(op))
                  return WalkResult::interrupt();
                if (auto atomic = dyn_cast<AtomicOp>(op);
                    atomic && !atomic.getExclusive())
                  return WalkResult::interrupt();
                if (isa<MatmulOp, InverseOp, DeterminantOp>(op))
                  return WalkResult::interrupt();
                return WalkResult::advance();
              })
              .wasInterrupted();
}
