//===- DropDeadCarried.cpp - Carried values that nothing needs ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A loop that is recomputed for one of its values carries them all. A sum, for
// example, feeds only itself there; no local rewrite sees that it is dead.
//
//===----------------------------------------------------------------------===//

#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/AD/AdjointBuilder.h"

using namespace mlir;
using namespace mlir::tai;

/// Which carried values results in use and effects in the body need.
static SmallVector<bool> findLiveCarried(scf::ForOp loop) {
  SmallVector<bool> live(loop.getNumRegionIterArgs(), false);
  Block *body = loop.getBody();
  DenseSet<Operation *> visited;
  SmallVector<Value> worklist;
  auto visitOp = [&](Operation *op) {
    if (visited.insert(op).second)
      op->walk([&](Operation *nested) {
        llvm::append_range(worklist, nested->getOperands());
      });
  };
  auto visitCarried = [&](unsigned index) {
    if (live[index])
      return;
    live[index] = true;
    worklist.push_back(loop.getYieldedValues()[index]);
  };
  for (OpResult result : loop.getResults())
    if (!result.use_empty())
      visitCarried(result.getResultNumber());
  for (Operation &op : body->without_terminator())
    if (!wouldOpBeTriviallyDead(&op))
      visitOp(&op);
  while (!worklist.empty()) {
    Value value = worklist.pop_back_val();
    if (auto argument = dyn_cast<BlockArgument>(value)) {
      if (argument.getOwner() == body && argument.getArgNumber() != 0)
        visitCarried(argument.getArgNumber() - 1);
    } else if (Operation *op =
                   body->findAncestorOpInBlock(*value.getDefiningOp())) {
      visitOp(op);
    }
  }
  return live;
}

/// Erases the ops of `block` whose results nothing uses.
static void eraseDeadOps(Block *block) {
  for (Operation &op : llvm::make_early_inc_range(llvm::reverse(*block)))
    if (isOpTriviallyDead(&op)) // never a terminator
      op.erase();
}

static scf::ForOp dropFromLoop(scf::ForOp loop) {
  SmallVector<bool> live = findLiveCarried(loop);
  if (!llvm::is_contained(live, false))
    return loop;
  auto filter = [&](ValueRange values) {
    SmallVector<Value> kept;
    for (auto [value, isLive] : llvm::zip(values, live))
      if (isLive)
        kept.push_back(value);
    return kept;
  };
  OpBuilder builder(loop);
  auto smaller = scf::ForOp::create(builder, loop.getLoc(),
                                    loop.getLowerBound(), loop.getUpperBound(),
                                    loop.getStep(), filter(loop.getInitArgs()));
  smaller.getRegion().takeBody(loop.getRegion());
  Block *body = smaller.getBody();
  Operation *yield = body->getTerminator();
  yield->setOperands(filter(yield->getOperands()));
  eraseDeadOps(body);
  unsigned kept = 0;
  for (auto [result, isLive] : llvm::zip(loop.getResults(), live)) {
    if (isLive) {
      result.replaceAllUsesWith(smaller.getResult(kept++));
      continue;
    }
    // Only ops that feed each other in a circle can still use it.
    BlockArgument argument = body->getArgument(1 + kept);
    argument.replaceAllUsesWith(loop.getInitArgs()[result.getResultNumber()]);
    body->eraseArgument(1 + kept);
  }
  loop.erase();
  return smaller;
}

void mlir::tai::dropDeadCarried(Region &region) {
  // Outer loops first: they may carry results of inner ones.
  for (Block &block : region)
    for (Operation &op : llvm::make_early_inc_range(block)) {
      Operation *kept = &op;
      if (auto loop = dyn_cast<scf::ForOp>(op))
        kept = dropFromLoop(loop);
      for (Region &nested : kept->getRegions())
        dropDeadCarried(nested);
    }
}
