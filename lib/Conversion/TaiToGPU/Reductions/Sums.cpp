//===- Sums.cpp - Sums of all iterations of a loop ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Sums over all iterations are accumulated in a register of each thread, and
// reduced over a block before they are added to memory. In deterministic mode,
// a fixed number of threads keeps partial float sums, and later loops add them
// up. A thread accumulates f32 in f64, to reduce the rounding error of
// sequential addition, and so do blocks of loops with many iterations.
//
//===----------------------------------------------------------------------===//

#include "Sums.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Transforms/Utils/IndexMath.h"
#include "tai/Transforms/Utils/SumOrder.h"

using namespace mlir;
using namespace mlir::tai;

/// The number of chunks whose sums are added one after another at the end. A
/// loop that one warp runs has a single chunk, with a part for each thread.
static int64_t getNumChunks(ParallelForOp loop) {
  if (loop.getInWarp())
    return 1;
  std::optional<int64_t> count = getNumIterations(loop);
  if (!count)
    return SumOrder::kChunks;
  int64_t chunks = llvm::divideCeil(*count, getChunkLength(*count));
  return std::max<int64_t>(1, chunks);
}

int64_t tai::getSumThreads(ParallelForOp loop) {
  return getNumChunks(loop) * SumOrder::kLanes;
}

static Type getKeptType(AtomicKind kind, Type type) {
  return isa<FloatType>(type) ? getLaneType(kind, type) : type;
}

/// Emits loops after `loop` that add up the partial sums of its virtual
/// threads, which are the lanes of its chunks. Returns the address of the first
/// partial sum.
static Value emitPartialSums(ParallelForOp loop, Value frame, AtomicKind kind,
                             Type type, Value target, RuntimeCalls &runtime) {
  OpBuilder builder(loop);
  Location loc = loop.getLoc();
  Type kept = getKeptType(kind, type), storage = getStorageType(kept);
  auto scratch = [&](int64_t count) {
    return runtime.tai_rt_device_scratch(builder, loc, frame,
                                         runtime.i64(builder, loc, 8 * count));
  };
  int64_t numGroups = getNumChunks(loop) * SumOrder::kGroups;
  Value partials = scratch(getSumThreads(loop)), groups = scratch(numGroups);
  builder.setInsertionPointAfter(loop);
  IndexMath outside(builder, loc);
  Value zero = outside.constant(0), one = outside.constant(1);
  auto perGroup =
      ParallelForOp::create(builder, loc, zero, outside.constant(numGroups));
  OpBuilder b = OpBuilder::atBlockBegin(&perGroup.getBody().front());
  Value group = perGroup.getInductionVars().front();
  IndexMath math(b, loc);
  Value chunk = math.div(group, SumOrder::kGroups);
  Value own = math.rem(group, SumOrder::kGroups);
  Value lanes =
      emitPointer(b, loc, storage, partials, math.mul(chunk, SumOrder::kLanes));
  // LoopAccesses reads the strides and extents of chunks and lanes from this
  // attribute.
  int64_t bytes = llvm::divideCeil(kept.getIntOrFloatBitWidth(), 8);
  AliasScopes inChunks;
  inChunks.digits =
      b.getDenseI64ArrayAttr({bytes * SumOrder::kLanes, getNumChunks(loop), 0,
                              bytes, SumOrder::kLanes, 0});
  emitLaneTree(b, loc, kind, kept, lanes, own, SumOrder::kGroups, inChunks);
  Value sum = emitLoad(b, loc, kept, emitPointer(b, loc, storage, lanes, own),
                       inChunks);
  emitStore(b, loc, sum, emitPointer(b, loc, storage, groups, group),
            AliasScopes());
  auto all = ParallelForOp::create(builder, loc, zero, one);
  b.setInsertionPointToStart(&all.getBody().front());
  Value start = arith::ConstantOp::create(b, loc, getLaneStart(kind, kept));
  IndexMath last(b, loc);
  auto add = scf::ForOp::create(
      b, loc, last.constant(0), last.constant(numGroups), last.constant(1),
      start, [&](OpBuilder &in, Location, Value i, ValueRange sums) {
        Value number =
            emitLoad(in, loc, kept, emitPointer(in, loc, storage, groups, i),
                     AliasScopes());
        scf::YieldOp::create(
            in, loc, emitCombination(in, loc, kind, sums.front(), number));
      });
  sum = add.getResult(0);
  if (kept != type)
    sum = arith::TruncFOp::create(b, loc, type, sum);
  emitPlainUpdate(b, loc, kind, sum, target, AliasScopes());
  return partials;
}

/// Emits a loop of one iteration after `loop` that adds the sum of all blocks
/// to the target. Returns the address of that sum, which is zero between
/// launches.
static Value emitWideSum(ParallelForOp loop, Value frame, Type type,
                         Value target, RuntimeCalls &runtime) {
  OpBuilder builder(loop);
  Location loc = loop.getLoc();
  Type wide = builder.getF64Type();
  Value sum = runtime.tai_rt_device_scratch(builder, loc, frame,
                                            runtime.i64(builder, loc, 8));
  builder.setInsertionPointAfter(loop);
  IndexMath outside(builder, loc);
  auto once = ParallelForOp::create(builder, loc, outside.constant(0),
                                    outside.constant(1));
  OpBuilder b = OpBuilder::atBlockBegin(&once.getBody().front());
  Value found = emitLoad(b, loc, wide, sum, AliasScopes());
  // The sum is reset, because a replay of the launch does not clear scratch
  // memory.
  emitStore(
      b, loc,
      arith::ConstantOp::create(b, loc, getIdentity(AtomicKind::Add, wide)),
      sum, AliasScopes());
  found = arith::TruncFOp::create(b, loc, type, found);
  emitAtomicUpdate(b, loc, AtomicKind::Add, found, target, AliasScopes());
  return sum;
}

static bool hasLanes(ReductionAttr reduction) {
  return reduction.getOrder() == ReductionOrder::Lanes ||
         reduction.getOrder() == ReductionOrder::Common;
}

LogicalResult tai::prepareSums(ParallelForOp loop, Value frame,
                               DeviceLowering &lowering) {
  if (failed(checkOrderIsFixed(loop)))
    return failure();
  FieldTable &fields = lowering.device.fields;
  OpBuilder builder(loop);
  Location loc = loop.getLoc();
  auto outside = [&](ValueRange values) {
    return llvm::map_to_vector(values, [&](Value value) -> Value {
      if (loop.isDefinedOutsideOfLoop(value))
        return value;
      return IndexMath(builder, loc).constant(*getConstantIntValue(value));
    });
  };
  SmallVector<Operation *> updates;
  WalkResult result = loop.walk([&](Operation *op) {
    if (isKeptInRegister(op)) {
      updates.push_back(op);
      return WalkResult::advance();
    }
    if (!isa<AtomicOp>(op))
      return WalkResult::advance();
    op->emitOpError("cannot be lowered for a GPU; expects tai-lower-layout to "
                    "run before");
    return WalkResult::interrupt();
  });
  if (result.wasInterrupted())
    return failure();
  for (auto [i, total] : llvm::enumerate(groupTotals(updates))) {
    Operation *first = total.front();
    builder.setInsertionPoint(loop);
    Value target;
    if (auto atomic = dyn_cast<AtomicOp>(first)) {
      FailureOr<const FieldInfo *> field =
          fields.lookup(atomic, atomic.getFieldAttr());
      if (failed(field))
        return failure();
      SmallVector<Value> zeroBased =
          emitZeroBased(builder, loc, **field, outside(atomic.getIndices()));
      Value offset = emitElementOffset(builder, loc, **field, zeroBased,
                                       outside(atomic.getComponents()));
      target = emitPointer(builder, loc, getStorageType((*field)->scalarType),
                           emitFieldBase(builder, loc, **field), offset);
    } else {
      target = cast<LLVM::AtomicRMWOp>(first).getPtr();
    }
    ReductionAttr reduction = getReduction(first);
    Type type = getTermType(first);
    if (hasLanes(reduction))
      target = emitPartialSums(loop, frame, getCombiningKind(first), type,
                               target, lowering.host.runtime);
    else if (reduction.getDigits() == SumDigits::Wide)
      target = emitWideSum(loop, frame, type, target, lowering.host.runtime);
    builder.setInsertionPointToStart(&loop.getBody().front());
    auto marker = UnrealizedConversionCastOp::create(builder, loc,
                                                     target.getType(), target);
    marker->setAttr(kSumTargetAttrName, builder.getI64IntegerAttr(i));
    for (Operation *update : total)
      update->setAttr(kSumTargetAttrName, builder.getI64IntegerAttr(i));
  }
  return success();
}

static int64_t getSumNumber(Operation *op) {
  return op->getAttrOfType<IntegerAttr>(kSumTargetAttrName).getInt();
}

SmallVector<Sum> tai::collectSums(ParallelForOp loop, FieldTable &fields) {
  SmallVector<Sum> sums;
  auto at = [&](Operation *op) -> Sum & {
    size_t number = getSumNumber(op);
    if (sums.size() <= number)
      sums.resize(number + 1);
    return sums[number];
  };
  SmallVector<Operation *> markers;
  loop.walk([&](Operation *op) {
    if (!op->hasAttr(kSumTargetAttrName))
      return;
    Sum &sum = at(op);
    if (auto marker = dyn_cast<UnrealizedConversionCastOp>(op)) {
      sum.target = marker.getOperand(0);
      markers.push_back(marker);
      return;
    }
    sum.updates.push_back(op);
    sum.kind = getCombiningKind(op);
    sum.type = getTermType(op);
    sum.isPartial = hasLanes(getReduction(op));
    sum.isWide =
        !sum.isPartial && getReduction(op).getDigits() == SumDigits::Wide;
    if (auto atomic = dyn_cast<AtomicOp>(op)) {
      auto field = fields.lookup(atomic, atomic.getFieldAttr());
      if (succeeded(field))
        sum.scope = fields.getScopes(**field).own;
    }
  });
  for (Operation *marker : markers)
    marker->erase();
  for (Sum &sum : sums) {
    sum.kept = getKeptType(sum.kind, sum.type);
    if (sum.isWide)
      sum.type = sum.kept;
  }
  return sums;
}

/// Returns the function of the device library that reduces over a block, or "".
static std::string getBlockFunction(AtomicKind kind, Type type) {
  bool isFloat = type.isF32() || type.isF64();
  if (!isFloat && !type.isInteger(32) && !type.isInteger(64))
    return "";
  StringRef name;
  switch (kind) {
  case AtomicKind::Add:
    name = "add";
    break;
  case AtomicKind::Mul:
    name = "mul";
    break;
  case AtomicKind::Min:
    name = "min";
    break;
  case AtomicKind::Max:
    name = "max";
    break;
  case AtomicKind::And:
    name = "and";
    break;
  case AtomicKind::Or:
    name = "or";
    break;
  case AtomicKind::Xor:
    name = "xor";
    break;
  default:
    return "";
  }
  return ("tai_dev_reduce_" + name + (isFloat ? "_f" : "_i") +
          Twine(type.getIntOrFloatBitWidth()))
      .str();
}

void tai::emitSumStart(OpBuilder &builder, Location loc, Sum &sum) {
  sum.slot = emitStackSlots(builder, loc, 1);
  Value identity =
      arith::ConstantOp::create(builder, loc, getIdentity(sum.kind, sum.kept));
  emitSlotStore(builder, loc, identity, sum.slot);
}

void tai::rewriteUpdates(Sum &sum) {
  for (Operation *update : sum.updates) {
    OpBuilder builder(update);
    Location loc = update->getLoc();
    auto atomic = dyn_cast<AtomicOp>(update);
    AtomicKind kind = atomic ? atomic.getKind() : AtomicKind::Add;
    Value value =
        atomic ? atomic.getValue() : cast<LLVM::AtomicRMWOp>(update).getVal();
    if (value.getType() != sum.kept)
      value = arith::ExtFOp::create(builder, loc, sum.kept, value);
    Value old = emitSlotLoad(builder, loc, sum.kept, sum.slot);
    emitSlotStore(builder, loc, emitCombination(builder, loc, kind, old, value),
                  sum.slot);
    update->erase();
  }
}

void tai::emitSumEnd(OpBuilder &builder, Location loc, Sum &sum,
                     RuntimeCalls &runtime) {
  Value value = emitSlotLoad(builder, loc, sum.kept, sum.slot);
  if (sum.kept != sum.type)
    value = arith::TruncFOp::create(builder, loc, sum.type, value);
  std::string name = getBlockFunction(sum.kind, sum.type);
  if (name.empty())
    emitAtomicUpdate(builder, loc, sum.kind, value, sum.target, AliasScopes());
  else
    runtime.call(builder, loc, name, Type(), {sum.target, value});
}
