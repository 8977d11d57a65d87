//===- SplitAdjointZeroing.cpp - Loop fission of adjoint zeroing ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// If the reverse of a stencil zeroes adjoints in the same loop, its scattered
// additions depend on elements that other iterations zero, and cannot be turned
// into gathers. If nothing else in the loop changes these elements, they can be
// zeroed in a separate loop that runs afterwards.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "mlir/IR/PatternMatch.h"
#include "mlir/Transforms/RegionUtils.h"
#include "tai/AD/Reverse/AdjointBuilder.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

/// True for ops that a copy of the loop may repeat or omit.
static bool isHarmless(Operation *op) {
  return isa<LoadOp, AtomicOp, StoreOp>(op) || isMemoryEffectFree(op) ||
         op->hasTrait<OpTrait::HasRecursiveMemoryEffects>();
}

/// The stores of the loop, if all of them store zero and can be made in a later
/// loop. Empty otherwise, or if the loop does not scatter.
static SmallVector<StoreOp> findZeroed(ParallelForOp loop) {
  SmallVector<StoreOp> zeroed;
  SmallVector<LoadOp> loads;
  llvm::SmallDenseSet<const void *> added;
  bool isFit = true, scatters = false;
  loop.getBody().walk([&](Operation *op) {
    isFit &= isHarmless(op) && (op->getNumRegions() == 0 || isa<scf::IfOp>(op));
    if (auto store = dyn_cast<StoreOp>(op)) {
      zeroed.push_back(store);
      isFit &= matchPattern(store.getValue(), m_AnyZeroFloat()) ||
               matchPattern(store.getValue(), m_Zero());
    } else if (auto load = dyn_cast<LoadOp>(op)) {
      loads.push_back(load);
    } else if (auto atomic = dyn_cast<AtomicOp>(op)) {
      added.insert(getStorageKey(op));
      scatters |= !atomic.getExclusive();
      isFit &= atomic.getOld().use_empty();
    }
  });
  if (!isFit || !scatters)
    return {};
  for (StoreOp store : zeroed) {
    if (added.contains(getStorageKey(store)))
      return {};
    for (LoadOp load : loads)
      if (getStorageKey(load) == getStorageKey(store) &&
          mayReachLater(
              cast<DifferentiableAccessInterface>(store.getOperation()),
              cast<DifferentiableAccessInterface>(load.getOperation())))
        return {};
  }
  return zeroed;
}

void mlir::tai::splitAdjointZeroing(FunctionOpInterface adjoint) {
  SmallVector<ParallelForOp> loops;
  adjoint.getFunctionBody().walk([&](ParallelForOp loop) {
    if (!loop.getSerialize())
      loops.push_back(loop);
  });
  for (ParallelForOp loop : loops) {
    SmallVector<StoreOp> zeroed = findZeroed(loop);
    if (zeroed.empty())
      continue;
    OpBuilder builder(loop->getContext());
    builder.setInsertionPointAfter(loop);
    Operation *zeroing = builder.clone(*loop);
    for (StoreOp store : zeroed)
      store.erase();
    zeroing->walk([](AtomicOp atomic) { atomic.erase(); });
    IRRewriter rewriter(loop->getContext());
    (void)runRegionDCE(rewriter, zeroing->getRegions());
  }
}
