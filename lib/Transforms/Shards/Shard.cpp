//===- Shard.cpp - Loops of one rank of a mesh ----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "ShardPlan.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/IR/BuiltinOps.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/IR/Remarks.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "mlir/Transforms/GreedyPatternRewriteDriver.h"
#include "tai/ABI/Abi.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Support/Places.h"
#include "tai/Transforms/Shards/Passes.h"
#include "tai/Transforms/Utils/GatherAdditions.h"
#include "llvm/Support/raw_ostream.h"
#include "llvm/Support/xxhash.h"

namespace mlir::tai {
#define GEN_PASS_DEF_SHARD
#include "tai/Transforms/Shards/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// Computes in front of the loop a value that is the same in all iterations.
static Value hoist(OpBuilder &builder, Value value, ParallelForOp loop,
                   IRMapping &known) {
  if (!loop->isAncestor(value.getParentRegion()->getParentOp()))
    return value;
  if (Value done = known.lookupOrNull(value))
    return done;
  Operation *op = value.getDefiningOp();
  for (Value operand : op->getOperands())
    known.map(operand, hoist(builder, operand, loop, known));
  builder.clone(*op, known);
  return known.lookup(value);
}

static void emitExchanges(OpBuilder &builder, ParallelForOp loop,
                          ArrayRef<PlannedExchange> exchanges, OpBuilder &above,
                          IRMapping &known) {
  for (const PlannedExchange &planned : exchanges) {
    SmallVector<Value> at;
    for (Value value : planned.at.values)
      at.push_back(hoist(above, value, loop, known));
    ExchangeOp::create(
        builder, planned.loc,
        ExchangeKindAttr::get(builder.getContext(), planned.kind),
        planned.field, builder.getI64IntegerAttr(planned.before),
        builder.getI64IntegerAttr(planned.after), at,
        builder.getDenseI64ArrayAttr(planned.at.dims), IntegerAttr());
  }
}

static std::string formatLine(Location loc) {
  FileLineColLoc place = findFileLocation(loc);
  return place ? std::to_string(place.getLine()) : "";
}

/// Turns a loop over a field without sparse levels into one over its box of
/// indices.
static ParallelForOp toBox(OpBuilder &builder, ParallelForOp loop) {
  if (!loop.isStructFor())
    return loop;
  Location loc = loop.getLoc();
  FailureOr<FieldLayout> layout =
      getFieldLayout(lookupField(loop, loop.getFieldAttr()));
  SmallVector<Value> lower, upper;
  for (auto [first, extent] : llvm::zip(layout->offset, layout->shape)) {
    lower.push_back(arith::ConstantIndexOp::create(builder, loc, first));
    upper.push_back(
        arith::ConstantIndexOp::create(builder, loc, first + extent));
  }
  auto box = ParallelForOp::create(builder, loc, lower, upper);
  box.copyNotesFrom(loop);
  box.getBody().takeBody(loop.getBody());
  loop.erase();
  return box;
}

/// Limits a loop to the iterations of this rank. The first rank also runs those
/// in front of the field, the last rank those behind it, so that each iteration
/// runs once even if it accesses no row.
static void clip(OpBuilder &builder, ParallelForOp loop,
                 const ShardPlan &plan) {
  Location loc = loop.getLoc();
  auto constant = [&](int64_t value) -> Value {
    return arith::ConstantIndexOp::create(builder, loc, value);
  };
  Value rank = RankOp::create(builder, loc, builder.getIndexType(),
                              builder.getI64IntegerAttr(plan.sharding.ranks));
  Value block = constant(plan.sharding.block);
  Value row = arith::MulIOp::create(builder, loc, rank, block);
  Value first = arith::SubIOp::create(builder, loc, row, constant(plan.offset));
  Value end = arith::AddIOp::create(builder, loc, first, block);
  auto isRank = [&](int64_t number) -> Value {
    return arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::eq, rank,
                                 constant(number));
  };
  Value lower = loop.getLowerBounds()[plan.dimension];
  Value upper = loop.getUpperBounds()[plan.dimension];
  Value inner = arith::MaxSIOp::create(builder, loc, lower, first);
  Value newLower =
      arith::SelectOp::create(builder, loc, isRank(0), lower, inner);
  inner = arith::MinSIOp::create(builder, loc, upper, end);
  Value newUpper = arith::SelectOp::create(
      builder, loc, isRank(plan.sharding.ranks - 1), upper, inner);
  loop.getLowerBoundsMutable()[plan.dimension].set(newLower);
  loop.getUpperBoundsMutable()[plan.dimension].set(newUpper);
}

/// Fails the launch if data choose a row that the rank does not have.
static void emitChecks(ParallelForOp loop, const ShardPlan &plan) {
  for (const RowCheck &check : plan.checks) {
    FieldAccessOpInterface access = check.access;
    OpBuilder above(loop), builder(access);
    Location loc = access.getLoc();
    auto constant = [&](OpBuilder &b, int64_t value) -> Value {
      return arith::ConstantIndexOp::create(b, loc, value);
    };
    const Sharding &sharding = check.sharding;
    Value rank = RankOp::create(above, loc, above.getIndexType(),
                                above.getI64IntegerAttr(sharding.ranks));
    Value row = arith::MulIOp::create(above, loc, rank,
                                      constant(above, sharding.block));
    Value first = arith::AddIOp::create(
        above, loc, row, constant(above, sharding.first - check.halo));
    Value end = arith::AddIOp::create(
        above, loc, first, constant(above, sharding.block + 2 * check.halo));
    Value index = access.getIndices()[sharding.dimension];
    auto compare = [&](arith::CmpIPredicate predicate, Value bound) -> Value {
      return arith::CmpIOp::create(builder, loc, predicate, index, bound);
    };
    Value holds = arith::AndIOp::create(
        builder, loc, compare(arith::CmpIPredicate::sge, first),
        compare(arith::CmpIPredicate::slt, end));
    std::string message =
        "data choose row {} of '" + access.getFieldAttr().getValue().str() +
        "' on a rank that has rows {} to {}, with a halo of " +
        std::to_string(check.halo) +
        "; migrate the particles first, or choose a larger halo";
    Value last = arith::SubIOp::create(builder, loc, end, constant(builder, 1));
    AssertOp::create(builder, loc, holds, builder.getStringAttr(message),
                     ValueRange{index, first, last},
                     builder.getI32IntegerAttr(TAI_FAIL_INDEX));
  }
}

/// Emits a remark for each communication of a loop.
static void report(ParallelForOp loop, const ShardPlan &plan) {
  if (!loop.getContext()->getRemarkEngine())
    return;
  auto function = loop->getParentOfType<FunctionOpInterface>();
  auto tell = [&](const PlannedExchange &exchange) {
    auto options =
        remark::RemarkOpts::name(stringifyExchangeKind(exchange.kind))
            .category("tai-exchanges")
            .function(function ? function.getName() : "");
    remark::passed(loop.getLoc(), options)
        << remark::metric("Field", exchange.field.getValue().str())
        << remark::metric("Before", std::to_string(exchange.before))
        << remark::metric("After", std::to_string(exchange.after))
        << remark::metric("Reason", plan.why.str())
        << remark::metric("Line", formatLine(exchange.loc));
  };
  for (const PlannedExchange &exchange : plan.before)
    if (exchange.kind == ExchangeKind::Fetch ||
        exchange.kind == ExchangeKind::Gather)
      tell(exchange);
  for (const PlannedExchange &exchange : plan.after)
    if (exchange.kind != ExchangeKind::Stale)
      tell(exchange);
}

/// Lets the owner of a row make all additions to it, if that needs only halos
/// that the loop reads. Returns the loops that take the place of the loop.
static SmallVector<ParallelForOp> gather(ParallelForOp loop,
                                         GatherOptions options) {
  // Additions at rows that data choose would be those of a wider halo.
  if (loop->hasAttr(kHaloAttrName))
    return {loop};
  options.use = GatherOptions::Use::TrialForRanks;
  OpBuilder builder(loop);
  auto copy = cast<ParallelForOp>(builder.clone(*loop));
  SmallVector<ParallelForOp> trial = gatherAdditions(copy, options);
  auto isGood = [](ParallelForOp part) {
    if (!touchesShards(part))
      return true;
    FailureOr<ShardPlan> plan = planShards(part, /*reports=*/false);
    return succeeded(plan) && !plan->isWhole &&
           llvm::none_of(plan->after, [](const PlannedExchange &exchange) {
             return exchange.kind == ExchangeKind::Collect;
           });
  };
  bool isChosen = !trial.empty() && llvm::all_of(trial, isGood);
  if (trial.empty())
    trial.push_back(copy);
  for (ParallelForOp part : trial)
    part.erase();
  if (!isChosen)
    return {loop};
  options.use = GatherOptions::Use::Ranks;
  return gatherAdditions(loop, options);
}

static LogicalResult shardLoop(ParallelForOp loop) {
  FailureOr<ShardPlan> plan = planShards(loop);
  if (failed(plan))
    return failure();
  OpBuilder before(loop), after(loop);
  IRMapping known;
  emitExchanges(before, loop, plan->before, before, known);
  after.setInsertionPointAfter(loop);
  emitExchanges(after, loop, plan->after, before, known);
  report(loop, *plan);
  emitChecks(loop, *plan);
  if (plan->isWhole)
    return success();
  ParallelForOp box = toBox(before, loop);
  before.setInsertionPoint(box);
  clip(before, box, *plan);
  return success();
}

/// Marks the exchanges of a kernel with a hash of the kernel, by which ranks
/// find out that they run different programs.
static void setDigests(KernelOp kernel) {
  SmallVector<ExchangeOp> exchanges;
  kernel->walk([&](ExchangeOp op) { exchanges.push_back(op); });
  if (exchanges.empty())
    return;
  std::string text;
  llvm::raw_string_ostream os(text);
  kernel->print(os, OpPrintingFlags().useLocalScope());
  auto digest = static_cast<int64_t>(llvm::xxh3_64bits(text));
  Builder builder(kernel->getContext());
  for (ExchangeOp op : exchanges)
    op.setDigestAttr(builder.getI64IntegerAttr(digest));
}

/// Replaces the number of the process, if the module says it. The bounds of
/// loops are then constants, as those of a program of one process are. The ops
/// stay, and check the mesh of the process.
static LogicalResult fixRank(ModuleOp module) {
  auto rank = module->getAttrOfType<IntegerAttr>(kRankAttrName);
  if (!rank)
    return success();
  module->removeAttr(kRankAttrName);
  module->walk([&](RankOp op) {
    OpBuilder builder(op);
    Value constant =
        arith::ConstantIndexOp::create(builder, op.getLoc(), rank.getInt());
    op.replaceAllUsesWith(constant);
  });
  return applyPatternsGreedily(module, FrozenRewritePatternSet());
}

namespace {
struct Shard : tai::impl::ShardBase<Shard> {
  using Base::Base;

  void runOnOperation() override {
    bool isSharded = false;
    for (TreeOp tree : getOperation().getOps<TreeOp>()) {
      if (!hasShards(tree))
        continue;
      isSharded = true;
      if (failed(verifyShards(tree)))
        return signalPassFailure();
    }
    if (!isSharded)
      return;
    GatherOptions options;
    options.pairSums = pairSums;
    options.onDevice = onDevice;
    // As in front of tai-scatter-to-gather.
    if (gathers)
      getOperation()->walk(
          [](KernelOp kernel) { markExclusiveAtomics(kernel); });
    SmallVector<ParallelForOp> loops;
    WalkResult result =
        getOperation()->walk<WalkOrder::PreOrder>([&](Operation *op) {
          auto loop = dyn_cast<ParallelForOp>(op);
          if (loop && touchesShards(loop)) {
            loops.push_back(loop);
            return WalkResult::skip();
          }
          if (!findSharding(op, getNamedField(op)))
            return WalkResult::advance();
          op->emitError("cannot run on several ranks: outside of a parallel "
                        "loop, it accesses '")
              << getNamedField(op) << "', which is sharded";
          return WalkResult::interrupt();
        });
    if (result.wasInterrupted())
      return signalPassFailure();
    for (ParallelForOp loop : loops)
      for (ParallelForOp part :
           gathers ? gather(loop, options) : SmallVector<ParallelForOp>{loop})
        if (touchesShards(part) && failed(shardLoop(part)))
          return signalPassFailure();
    // Digests are equal on all ranks, so the rank is not known until they are.
    getOperation()->walk([](KernelOp kernel) { setDigests(kernel); });
    if (failed(fixRank(getOperation())))
      signalPassFailure();
  }
};
} // namespace
