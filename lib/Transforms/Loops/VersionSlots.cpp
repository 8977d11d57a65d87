//===- VersionSlots.cpp - Versions of a loop for slots that differ --------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A step from slot `a` to slot `b` of one field, both arguments of the launch,
// reads and writes the same elements if the two are equal. Programs launch it
// with slots that differ, which the kernel does not show. Two versions of the
// loop are made, for b > a and for b < a, in which the indices show it:
// analyses of indices see the distance as a value with a range.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/IndexBounds.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"
#include "llvm/ADT/MapVector.h"

namespace mlir::tai {
#define GEN_PASS_DEF_VERSIONSLOTS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

namespace {
/// Two indices from outside of a loop that are possibly equal, by which the
/// loop selects slots of a field.
struct SlotPair {
  Value first, second;
};
} // namespace

/// The first indices of two accesses to one storage that are the same in all
/// iterations and may be equal or not; none if other such indices tell the
/// accesses apart.
static std::optional<SlotPair> getOpenPair(ParallelForOp loop, ValueRange a,
                                           ValueRange b) {
  std::optional<SlotPair> open;
  for (auto [x, y] : llvm::zip_equal(a, b)) {
    if (!loop.isDefinedOutsideOfLoop(x) || !loop.isDefinedOutsideOfLoop(y))
      continue;
    if (areProvablyDistinct(x, y))
      return std::nullopt;
    if (!open && !areProvablyEqual(x, y))
      open = SlotPair{x, y};
  }
  return open;
}

/// Returns the two indices (slots) of which only a launch knows whether they
/// differ, if all accesses of the loop that may conflict have the same two.
static std::optional<SlotPair> findSlots(ParallelForOp loop) {
  llvm::MapVector<const void *, SmallVector<FieldAccessOpInterface>> accesses;
  bool adds = false;
  loop.getBody().walk([&](Operation *op) {
    if (!isa<LoadOp, StoreOp, AtomicOp>(op))
      return;
    accesses[getStorageKey(op)].push_back(cast<FieldAccessOpInterface>(op));
    auto atomic = dyn_cast<AtomicOp>(op);
    adds |= atomic && !atomic.getExclusive() &&
            isa<FloatType>(getElementTypeOrSelf(atomic.getValue().getType()));
  });
  // Other loops are vectorised behind a test that LLVM makes.
  if (!adds)
    return std::nullopt;
  std::optional<SlotPair> found;
  for (auto &[storage, all] : accesses)
    for (auto [number, access] : llvm::enumerate(all))
      for (FieldAccessOpInterface other :
           ArrayRef(all).drop_front(number + 1)) {
        if (isa<LoadOp>(access) && isa<LoadOp>(other))
          continue;
        std::optional<SlotPair> open =
            getOpenPair(loop, access.getIndices(), other.getIndices());
        if (!open)
          continue;
        if (!found)
          found = open;
        bool isKnown = areProvablyEqual(found->first, open->first) &&
                       areProvablyEqual(found->second, open->second);
        bool isSwapped = areProvablyEqual(found->first, open->second) &&
                         areProvablyEqual(found->second, open->first);
        if (!isKnown && !isSwapped)
          return std::nullopt;
      }
  return found;
}

/// Emits a copy of the loop in which the index `slots.second` is computed as
/// `slots.first` plus the distance of both, limited by `Limit` (a minimum or
/// maximum) to one side of zero.
template <typename Limit>
static void createVersion(ImplicitLocOpBuilder &b, ParallelForOp loop,
                          const SlotPair &slots, Value distance, int64_t step) {
  Value limited =
      Limit::create(b, distance, arith::ConstantIndexOp::create(b, step));
  Value apart = arith::AddIOp::create(b, slots.first, limited);
  auto version = cast<ParallelForOp>(b.clone(*loop));
  version.getBody().walk([&](FieldAccessOpInterface access) {
    for (OpOperand &operand : access->getOpOperands())
      if (operand.get().getType().isIndex() &&
          version.isDefinedOutsideOfLoop(operand.get()) &&
          areProvablyEqual(operand.get(), slots.second))
        operand.set(apart);
  });
}

static void version(ParallelForOp loop, const SlotPair &slots) {
  ImplicitLocOpBuilder b(loop.getLoc(), loop);
  Value zero = arith::ConstantIndexOp::create(b, 0);
  Value distance = arith::SubIOp::create(b, slots.second, slots.first);
  auto isAbove = [&](Value from, Value to) -> Value {
    return arith::CmpIOp::create(b, arith::CmpIPredicate::slt, from, to);
  };
  auto above = scf::IfOp::create(b, isAbove(zero, distance),
                                 /*withElseRegion=*/true);
  b.setInsertionPointToStart(above.thenBlock());
  createVersion<arith::MaxSIOp>(b, loop, slots, distance, 1);
  b.setInsertionPointToStart(above.elseBlock());
  auto below = scf::IfOp::create(b, isAbove(distance, zero),
                                 /*withElseRegion=*/true);
  b.setInsertionPointToStart(below.thenBlock());
  createVersion<arith::MinSIOp>(b, loop, slots, distance, -1);
  loop->moveBefore(below.elseBlock(), below.elseBlock()->begin());
}

namespace {
struct VersionSlots : tai::impl::VersionSlotsBase<VersionSlots> {
  using Base::Base;

  void runOnOperation() override {
    SmallVector<ParallelForOp> loops;
    getOperation()->walk<WalkOrder::PreOrder>([&](ParallelForOp loop) {
      loops.push_back(loop);
      return WalkResult::skip();
    });
    for (ParallelForOp loop : loops) {
      // Loops with sums of a common order are left alone, because another
      // target would add their terms in another order.
      if (loop.getSerialize() || loop.getInOrder() || checksIndices(loop) ||
          hasCommonOrder(loop))
        continue;
      int64_t ops = 0;
      loop.getBody().walk([&](Operation *) { ++ops; });
      if (ops > maxOps)
        continue;
      if (std::optional<SlotPair> slots = findSlots(loop))
        version(loop, *slots);
    }
  }
};
} // namespace
