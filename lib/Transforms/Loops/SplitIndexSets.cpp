//===- SplitIndexSets.cpp - Index-set splitting of parallel loops ---------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A serial loop whose body is a choice between an interior and a border body
// (see `tai-version-interior`) becomes a loop over the interior and loops over
// the borders. The two borders share one copy of their body, because code size
// is compile time.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/Index/IndexBuilder.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_SPLITINDEXSETS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

static constexpr StringLiteral kInterior = "tai.interior";

namespace {
/// A loop that can be split.
struct Split {
  scf::ForOp loop;
  scf::IfOp branch;
  /// The range of the loop index in the interior of the loop, [lower, upper).
  int64_t lower, upper;
};
} // namespace

/// Returns the constant c with value = iv + c, if there is one.
static std::optional<int64_t> getOffsetFrom(Value value, Value iv) {
  IndexExpr offset = getIndexExpr(value);
  if (!offset.isExact() || !offset.add(IndexExpr(iv), -1).isConstant())
    return std::nullopt;
  return offset.constant;
}

/// The loop around a marked branch, if nothing else in the loop has an effect.
static std::optional<Split> matchSplit(scf::IfOp branch) {
  auto interior = branch->getAttrOfType<DenseI64ArrayAttr>(kInterior);
  auto loop = dyn_cast<scf::ForOp>(branch->getParentOp());
  if (!interior || !loop || loop.getUnsignedCmp() || loop.getNumResults() ||
      branch.getNumResults() || !matchPattern(loop.getStep(), m_One()))
    return std::nullopt;
  for (Operation &op : loop.getBody()->without_terminator())
    if (&op != branch && !isMemoryEffectFree(&op))
      return std::nullopt;
  // The test compares the program's index, which differs from the loop's
  // variable by a constant.
  auto both = branch.getCondition().getDefiningOp<arith::AndIOp>();
  auto test = both ? both.getLhs().getDefiningOp<arith::CmpIOp>() : nullptr;
  if (!test)
    return std::nullopt;
  std::optional<int64_t> offset =
      getOffsetFrom(test.getLhs(), loop.getInductionVar());
  if (!offset)
    return std::nullopt;
  return Split{loop, branch, interior[0] - *offset, interior[1] - *offset};
}

/// Emits a copy of the loop over [lower, upper) that has the ops of `side`, one
/// arm, in place of the branch.
static void createPart(OpBuilder &builder, Split &split, Value lower,
                       Value upper, Block &side) {
  auto part = scf::ForOp::create(
      builder, split.loop.getLoc(), lower, upper, split.loop.getStep(),
      ValueRange(), [&](OpBuilder &nested, Location loc, Value iv, ValueRange) {
        IRMapping mapping;
        mapping.map(split.loop.getInductionVar(), iv);
        for (Operation &op : split.loop.getBody()->without_terminator()) {
          if (&op != split.branch) {
            nested.clone(op, mapping);
            continue;
          }
          for (Operation &inner : side.without_terminator())
            nested.clone(inner, mapping);
        }
        scf::YieldOp::create(nested, loc);
      });
  // Each of the loops keeps the attributes of the original loop, which state
  // facts about its iterations.
  part->setDiscardableAttrs(split.loop->getDiscardableAttrDictionary());
}

static void apply(Split &split) {
  OpBuilder builder(split.loop);
  Location loc = split.loop.getLoc();
  Type type = split.loop.getInductionVar().getType();
  auto constant = [&](int64_t value) -> Value {
    return arith::ConstantOp::create(builder, loc,
                                     builder.getIntegerAttr(type, value));
  };
  Value lower = split.loop.getLowerBound(), upper = split.loop.getUpperBound();
  // The bounds are clamped to the range of the loop, so that lower <= first <=
  // last <= upper even where the range misses the interior.
  auto clamp = [&](int64_t value) -> Value {
    Value above = arith::MaxSIOp::create(builder, loc, lower, constant(value));
    return arith::MinSIOp::create(builder, loc, above, upper);
  };
  Value first = clamp(split.lower);
  Value last = clamp(split.upper);

  Value zero = arith::ConstantIndexOp::create(builder, loc, 0);
  Value one = arith::ConstantIndexOp::create(builder, loc, 1);
  Value two = arith::ConstantIndexOp::create(builder, loc, 2);
  createPart(builder, split, first, last, split.branch.getThenRegion().front());
  scf::ForOp::create(
      builder, loc, zero, two, one, ValueRange(),
      [&](OpBuilder &nested, Location, Value end, ValueRange) {
        Value isLow = arith::CmpIOp::create(
            nested, loc, arith::CmpIPredicate::eq, end, zero);
        Value from = arith::SelectOp::create(nested, loc, isLow, lower, last);
        Value to = arith::SelectOp::create(nested, loc, isLow, first, upper);
        createPart(nested, split, from, to,
                   split.branch.getElseRegion().front());
        scf::YieldOp::create(nested, loc);
      });
  split.loop.erase();
}

namespace {
struct SplitIndexSets : tai::impl::SplitIndexSetsBase<SplitIndexSets> {
  using Base::Base;

  void runOnOperation() override {
    SmallVector<Split> splits;
    walkOwned(getOperation(), [&](Operation *owned) {
      owned->walk([&](scf::IfOp branch) {
        if (std::optional<Split> split = matchSplit(branch))
          splits.push_back(*split);
      });
    });
    for (Split &split : splits)
      apply(split);
  }
};
} // namespace
