//===- DropDeadCarried.cpp - Dead loop-carried values ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A loop that is recomputed for one of its carried values carries all of them.
// A carried sum that feeds only itself is dead, but no local rewrite sees that.
//
//===----------------------------------------------------------------------===//

#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/AD/Reverse/AdjointBuilder.h"
#include "tai/Analysis/CarriedValues.h"

using namespace mlir;
using namespace mlir::tai;

template <typename Range>
static SmallVector<Value> filter(Range &&values, ArrayRef<bool> kept) {
  SmallVector<Value> result;
  for (auto [value, isKept] : llvm::zip(values, kept))
    if (isKept)
      result.push_back(value);
  return result;
}

/// Erases those arguments of `block`, counted from `first`, for which `kept` is
/// false. Only dead ops can still use an erased argument; they get the
/// corresponding entry of `values` instead.
static void eraseArguments(Block *block, unsigned first, ArrayRef<bool> kept,
                           ValueRange values) {
  for (size_t i = kept.size(); i-- != 0;)
    if (!kept[i]) {
      block->getArgument(first + i).replaceAllUsesWith(values[i]);
      block->eraseArgument(first + i);
    }
}

static void replaceResults(Operation *loop, Operation *smaller,
                           ArrayRef<bool> kept, ValueRange values) {
  unsigned next = 0;
  for (OpResult result : loop->getResults())
    result.replaceAllUsesWith(kept[result.getResultNumber()]
                                  ? Value(smaller->getResult(next++))
                                  : values[result.getResultNumber()]);
  loop->erase();
}

static void dropFromFor(scf::ForOp loop, ArrayRef<bool> kept) {
  OpBuilder builder(loop);
  SmallVector<Value> inits(loop.getInitArgs());
  auto smaller = scf::ForOp::create(
      builder, loop.getLoc(), loop.getLowerBound(), loop.getUpperBound(),
      loop.getStep(), filter(inits, kept), /*bodyBuilder=*/nullptr,
      loop.getUnsignedCmp());
  smaller.getRegion().takeBody(loop.getRegion());
  Block *body = smaller.getBody();
  Operation *yield = body->getTerminator();
  yield->setOperands(filter(yield->getOperands(), kept));
  eraseArguments(body, 1, kept, inits);
  replaceResults(loop, smaller, kept, inits);
}

/// Drops carried values from an scf.while. `kept` marks the carried values to
/// keep; `passed` marks the operands of the condition to keep.
static void dropFromWhile(scf::WhileOp loop, ArrayRef<bool> kept,
                          ArrayRef<bool> passed) {
  OpBuilder builder(loop);
  SmallVector<Value> inits(loop.getInits());
  // Dropped results have only dead users, so any value may replace them.
  SmallVector<Value> dead;
  for (Type type : loop.getResultTypes())
    dead.push_back(
        UnrealizedConversionCastOp::create(builder, loop.getLoc(), type, {})
            .getResult(0));
  SmallVector<Type> types;
  for (auto [type, isPassed] : llvm::zip(loop.getResultTypes(), passed))
    if (isPassed)
      types.push_back(type);
  auto smaller =
      scf::WhileOp::create(builder, loop.getLoc(), types, filter(inits, kept));
  smaller.getBefore().takeBody(loop.getBefore());
  smaller.getAfter().takeBody(loop.getAfter());
  scf::ConditionOp condition = smaller.getConditionOp();
  SmallVector<Value> arguments = filter(condition.getArgs(), passed);
  condition.getArgsMutable().assign(arguments);
  scf::YieldOp yield = smaller.getYieldOp();
  yield->setOperands(filter(yield->getOperands(), kept));
  eraseArguments(smaller.getBeforeBody(), 0, kept, inits);
  eraseArguments(smaller.getAfterBody(), 0, passed, dead);
  replaceResults(loop, smaller, passed, dead);
}

static void eraseDeadOps(Region &region) {
  for (Block &block : region)
    for (Operation &op : llvm::make_early_inc_range(llvm::reverse(block))) {
      for (Region &nested : op.getRegions())
        eraseDeadOps(nested);
      if (isOpTriviallyDead(&op)) // never a terminator
        op.erase();
    }
}

void mlir::tai::dropDeadCarried(Region &region) {
  LiveValues live(region);
  auto find = [&](ValueRange values, ValueRange others) {
    SmallVector<bool> kept;
    for (auto [i, value] : llvm::enumerate(values))
      kept.push_back(live.isLive(value) ||
                     (!others.empty() && live.isLive(others[i])));
    return kept;
  };
  struct Drop {
    Operation *loop;
    SmallVector<bool> kept, passed;
  };
  SmallVector<Drop> drops;
  region.walk([&](Operation *op) {
    if (auto loop = dyn_cast<scf::ForOp>(op)) {
      SmallVector<bool> kept =
          find(loop.getRegionIterArgs(), loop.getResults());
      if (llvm::is_contained(kept, false))
        drops.push_back({op, kept, {}});
    } else if (auto loop = dyn_cast<scf::WhileOp>(op)) {
      SmallVector<bool> kept = find(loop.getBeforeArguments(), {});
      SmallVector<bool> passed =
          find(loop.getAfterArguments(), loop.getResults());
      if (llvm::is_contained(kept, false) || llvm::is_contained(passed, false))
        drops.push_back({op, kept, passed});
    }
  });
  for (Drop &drop : drops) {
    if (auto loop = dyn_cast<scf::ForOp>(drop.loop))
      dropFromFor(loop, drop.kept);
    else
      dropFromWhile(cast<scf::WhileOp>(drop.loop), drop.kept, drop.passed);
  }
  eraseDeadOps(region);
}
