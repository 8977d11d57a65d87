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
// analyses of indices see the distance as a value with a range. Three slots
// have six orders, with a version each.
//
//===----------------------------------------------------------------------===//

#include "VersionRemarks.h"
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

/// Two indices from outside of a loop that are possibly equal, by which the
/// loop selects slots of a field.
using SlotPair = std::pair<Value, Value>;

/// The most slots of a loop with versions.
static constexpr size_t kMostSlots = 3;
/// The versions of three slots against those of two.
static constexpr int64_t kCopiesOfThree = 3;

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

/// Returns the indices (slots) of which only a launch knows whether they
/// differ, in all accesses of the loop that may conflict. The search ends
/// beyond kMostSlots.
static SmallVector<Value> findSlots(ParallelForOp loop) {
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
    return {};
  SmallVector<Value> found;
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
        for (Value slot : {open->first, open->second})
          if (llvm::none_of(found, [&](Value other) {
                return areProvablyEqual(slot, other);
              }))
            found.push_back(slot);
        if (found.size() > kMostSlots)
          return found;
      }
  return found;
}

/// Replaces the index `slot` in the accesses of a version of a loop.
static void replaceSlot(ParallelForOp version, Value slot, Value by) {
  version.getBody().walk([&](FieldAccessOpInterface access) {
    for (OpOperand &operand : access->getOpOperands())
      if (operand.get().getType().isIndex() &&
          version.isDefinedOutsideOfLoop(operand.get()) &&
          areProvablyEqual(operand.get(), slot))
        operand.set(by);
  });
}

/// Returns `slot` as the sum of `from` and the distance of both, limited by
/// `Limit` (a minimum or maximum) to one side of zero.
template <typename Limit>
static Value emitApart(ImplicitLocOpBuilder &b, Value from, Value distance,
                       int64_t step) {
  Value limited =
      Limit::create(b, distance, arith::ConstantIndexOp::create(b, step));
  return arith::AddIOp::create(b, from, limited);
}

/// Emits a copy of the loop in which the index `slots.second` is a limited
/// distance from `slots.first`.
template <typename Limit>
static void createVersion(ImplicitLocOpBuilder &b, ParallelForOp loop,
                          const SlotPair &slots, Value distance, int64_t step) {
  Value apart = emitApart<Limit>(b, slots.first, distance, step);
  replaceSlot(cast<ParallelForOp>(b.clone(*loop)), slots.second, apart);
}

/// Emits versions of the loop for each order of three slots.
static void versionThree(ParallelForOp loop, ArrayRef<Value> slots) {
  ImplicitLocOpBuilder b(loop.getLoc(), loop);
  Value zero = arith::ConstantIndexOp::create(b, 0);
  SmallVector<unsigned> order{0, 1, 2};
  do {
    Value low = slots[order[0]], middle = slots[order[1]],
          high = slots[order[2]];
    Value first = arith::SubIOp::create(b, middle, low);
    Value second = arith::SubIOp::create(b, high, middle);
    auto isAbove = [&](Value distance) -> Value {
      return arith::CmpIOp::create(b, arith::CmpIPredicate::slt, zero,
                                   distance);
    };
    auto branch = scf::IfOp::create(
        b, arith::AndIOp::create(b, isAbove(first), isAbove(second)),
        /*withElseRegion=*/true);
    b.setInsertionPointToStart(branch.thenBlock());
    Value above = emitApart<arith::MaxSIOp>(b, low, first, 1);
    Value top = emitApart<arith::MaxSIOp>(b, above, second, 1);
    auto version = cast<ParallelForOp>(b.clone(*loop));
    replaceSlot(version, middle, above);
    replaceSlot(version, high, top);
    b.setInsertionPointToStart(branch.elseBlock());
  } while (std::next_permutation(order.begin(), order.end()));
  loop->moveBefore(b.getInsertionBlock(), b.getInsertionBlock()->begin());
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
      SmallVector<Value> slots = findSlots(loop);
      if (slots.empty())
        continue;
      constexpr llvm::StringLiteral values = "slots that differ";
      if (slots.size() > kMostSlots) {
        reportVersions(loop, values,
                       "more than " + Twine(kMostSlots) + " may be equal");
        continue;
      }
      int64_t ops = 0;
      loop.getBody().walk([&](Operation *) { ++ops; });
      int64_t most = slots.size() == 2 ? maxOps : maxOps / kCopiesOfThree;
      if (ops > most) {
        reportVersions(loop, values,
                       "the loop has " + Twine(ops) +
                           " operations, and the limit is " + Twine(most));
        continue;
      }
      reportVersions(loop, values);
      if (slots.size() == 2)
        version(loop, {slots[0], slots[1]});
      else
        versionThree(loop, slots);
    }
  }
};
} // namespace
