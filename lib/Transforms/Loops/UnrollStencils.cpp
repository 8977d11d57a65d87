//===- UnrollStencils.cpp - Stencils that are written as loops ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `for k in range(-2, 3)` around `x[i + k]`, in a parallel loop over `i`, is a
// stencil: the sum of two indices is a shift of one of them once the loop is
// written out, and later passes gather its adjoint and give it an interior.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/SCF/Utils/Utils.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "tai/Analysis/Index/IndexShift.h"
#include "tai/Analysis/IndexBounds.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_UNROLLSTENCILS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// True if an access in the loop `inner` has an index that is a sum of the
/// index of `inner` and an index of `loop`.
static bool isStencil(scf::ForOp inner, ParallelForOp loop) {
  WalkResult result = inner.walk([&](Operation *op) {
    auto access = dyn_cast<FieldAccessOpInterface>(op);
    if (!access || !access.isElementAccess())
      return WalkResult::advance();
    for (Value index : access.getIndices()) {
      SmallVector<Value> variables;
      if (collectIndexVariables(index, loop.getBody(), variables) &&
          llvm::is_contained(variables, inner.getInductionVar()) &&
          llvm::any_of(loop.getInductionVars(), [&](Value iv) {
            return llvm::is_contained(variables, iv);
          }))
        return WalkResult::interrupt();
    }
    return WalkResult::advance();
  });
  return result.wasInterrupted();
}

static int64_t countOps(Region &region) {
  int64_t ops = 0;
  region.walk([&](Operation *) { ++ops; });
  return ops;
}

namespace {
struct UnrollStencils : tai::impl::UnrollStencilsBase<UnrollStencils> {
  using Base::Base;

  void runOnOperation() override {
    // Innermost loops come first.
    SmallVector<scf::ForOp> loops;
    getOperation()->walk([&](scf::ForOp loop) { loops.push_back(loop); });
    for (scf::ForOp inner : loops) {
      auto loop = inner->getParentOfType<ParallelForOp>();
      if (!loop || loop.getSerialize() || loop.getInOrder() ||
          checksIndices(loop) || hasCommonOrder(loop) ||
          !isStencil(inner, loop))
        continue;
      std::optional<APInt> trips = inner.getStaticTripCount();
      bool hasLoops = inner.getBody()
                          ->walk([](LoopLikeOpInterface) {
                            return WalkResult::interrupt();
                          })
                          .wasInterrupted();
      if (!trips || hasLoops || trips->isZero() || trips->ugt(maxTrips))
        continue;
      int64_t ops = countOps(inner.getRegion());
      int64_t around = countOps(loop.getBody());
      if (around + ops * (trips->getSExtValue() - 1) > maxOps)
        continue;
      // If unrolling fails, the loop stays as it is.
      (void)loopUnrollFull(inner);
    }
  }
};
} // namespace
