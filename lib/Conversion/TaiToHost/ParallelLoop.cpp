//===- ParallelLoop.cpp - Parallel loops become loops over partitions -----===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The body of a parallel loop becomes a function that runs a range of the
// linearised iterations. A row is the iterations along the last dimension: the
// innermost loop is a plain counted loop over a row or a part of it, which LLVM
// vectorises. With many rows, the range counts whole rows; otherwise the first
// and last rows of the range may be partial.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/ABI/SumModes.h"
#include "tai/Analysis/Cost.h"
#include "tai/Conversion/TaiToHost/Lowering.h"
#include "tai/Conversion/TaiToHost/Reductions/Accumulators.h"
#include "tai/Transforms/Utils/IndexMath.h"
#include "tai/Transforms/Utils/SumOrder.h"

using namespace mlir;
using namespace mlir::tai;

/// From this many rows of iterations on, a partition is made of whole rows:
/// enough for an even distribution over the cores of a large machine.
constexpr int64_t kManyRows = 64;

/// The minimum length of a row of iterations (along the last dimension) that
/// ends a block of a sum.
constexpr int64_t kShortRow = 32;

namespace {
/// The bounds and extents of a loop's box, as values defined before the loop.
struct Box {
  SmallVector<Value> lower, upper, extent;

  Box(ParallelForOp loop, OpBuilder &builder)
      : lower(loop.getLowerBounds()), upper(loop.getUpperBounds()) {
    IndexMath math(builder, loop.getLoc());
    for (auto [from, to] : llvm::zip(lower, upper))
      extent.push_back(math.extent(from, to));
  }
  size_t rank() const { return extent.size(); }

  /// Returns the product of the extents of the first `count` dimensions, if
  /// constant.
  std::optional<int64_t> constantCount(size_t count) const {
    int64_t product = 1;
    for (Value value : ArrayRef(extent).take_front(count)) {
      std::optional<int64_t> constant = getConstantIntValue(value);
      if (!constant || llvm::MulOverflow(product, *constant, product))
        return std::nullopt;
    }
    return product;
  }
  Value count(size_t dimensions, OpBuilder &builder, Location loc) const {
    IndexMath math(builder, loc);
    Value product = math.constant(1);
    for (Value value : ArrayRef(extent).take_front(dimensions))
      product = math.mul(product, value);
    return product;
  }
};
} // namespace

/// Moves the body of `loop` into the innermost of the loops that take its
/// place, with the given induction variables.
static void moveBody(ParallelForOp loop, scf::ForOp innermost, ValueRange ivs) {
  Block *block = innermost.getBody();
  Block &body = loop.getBody().front();
  for (auto [argument, iv] : llvm::zip(body.getArguments(), ivs))
    argument.replaceAllUsesWith(iv);
  body.getTerminator()->erase();
  block->getOperations().splice(block->getTerminator()->getIterator(),
                                body.getOperations());
  // Annotate the loop: accesses of this group do not depend on one another.
  auto group = loop->getAttrOfType<LLVM::AccessGroupAttr>(kAccessGroupAttrName);
  if (!group)
    return;
  auto annotation = LLVM::LoopAnnotationAttr::get(
      loop.getContext(), /*disableNonforced=*/{}, {}, {}, {}, {}, {}, {}, {},
      {}, {}, {}, {}, {}, {}, ArrayRef(group));
  innermost->setAttr("llvm.loop_annotation", annotation);
}

static scf::ForOp createFor(OpBuilder &builder, Location loc, Value lower,
                            Value upper) {
  Value one = arith::ConstantIndexOp::create(builder, loc, 1);
  return scf::ForOp::create(builder, loc, lower, upper, one);
}

/// Replaces a parallel loop by nested serial loops in its place.
static LogicalResult lowerSerially(ParallelForOp loop, const Box &box,
                                   FieldTable &fields) {
  SmallVector<AtomicOp> atomics;
  loop.walk([&](AtomicOp atomic) { atomics.push_back(atomic); });
  for (AtomicOp atomic : atomics)
    if (failed(lowerNonAtomic(atomic, fields)))
      return failure();
  OpBuilder builder(loop);
  SmallVector<Value> ivs;
  scf::ForOp innermost;
  for (auto [lower, upper] : llvm::zip(box.lower, box.upper)) {
    innermost = createFor(builder, loop.getLoc(), lower, upper);
    ivs.push_back(innermost.getInductionVar());
    builder.setInsertionPointToStart(innermost.getBody());
  }
  moveBody(loop, innermost, ivs);
  loop.erase();
  return success();
}

LogicalResult tai::lowerSerially(ParallelForOp loop, FieldTable &fields) {
  OpBuilder builder(loop);
  return ::lowerSerially(loop, Box(loop, builder), fields);
}

/// Emits the indices of all dimensions but the last, for the number of a row of
/// iterations.
static SmallVector<Value> delinearize(OpBuilder &builder, Location loc,
                                      const Box &box, Value row) {
  IndexMath math(builder, loc);
  SmallVector<Value> indices(box.rank() - 1);
  for (size_t d = indices.size(); d-- > 0;) {
    Value digit = d == 0 ? row : math.rem(row, box.extent[d]);
    if (d != 0)
      row = math.div(row, box.extent[d]);
    indices[d] = math.add(box.lower[d], digit);
  }
  return indices;
}

/// Emits the loops of a partition and moves the body into them. With `byRows`,
/// the range counts rows. A block of a sum ends after each row, or after the
/// maximum number of iterations of a block.
static void emitPartition(OpBuilder &builder, ParallelForOp loop,
                          const Box &box, Value begin, Value end, bool byRows,
                          Accumulators &accumulators) {
  Location loc = loop.getLoc();
  IndexMath math(builder, loc);
  Value lower = box.lower.back();
  auto endBlock = [&](scf::ForOp innermost) {
    std::optional<int64_t> length = getConstantIntValue(box.extent.back());
    if (length && *length < kShortRow)
      return;
    OpBuilder after(innermost->getContext());
    after.setInsertionPointAfter(innermost);
    accumulators.emitBlockEnd(after, loc, innermost);
  };
  int64_t most = accumulators.getBlockLength();
  std::optional<int64_t> known = getConstantIntValue(box.extent.back());
  bool inBlocks = most != 0 && !(known && *known <= most);
  auto enterBlocks = [&](Value &from, Value &to) {
    auto blocks =
        scf::ForOp::create(builder, loc, from, to, math.constant(most));
    builder.setInsertionPointToStart(blocks.getBody());
    from = blocks.getInductionVar();
    // The minimum tells LLVM the maximum length of a block; such a short loop
    // of iterations needs no safepoint.
    to = math.add(from, math.min(math.constant(most), math.sub(to, from)));
  };
  if (box.rank() == 1) {
    Value from = begin, to = end;
    if (inBlocks)
      enterBlocks(from, to);
    auto inner =
        createFor(builder, loc, math.add(lower, from), math.add(lower, to));
    moveBody(loop, inner, inner.getInductionVar());
    if (most != 0)
      endBlock(inner);
    return;
  }
  // A row of iterations, however long, is one block of the sum, unless the
  // terms of a block are stored.
  bool cutsRows = inBlocks && accumulators.storesTerms();

  // If partitions divide only the outer dimensions, a loop is emitted for each
  // dimension: the first loop runs over the range of the partition.
  if (loop.getOuterDims()) {
    SmallVector<Value> ivs;
    scf::ForOp inner;
    for (auto [d, first] : llvm::enumerate(box.lower)) {
      Value from = d == 0 ? math.add(first, begin) : first;
      Value to = d == 0 ? math.add(first, end) : box.upper[d];
      if (cutsRows && d + 1 == box.rank())
        enterBlocks(from, to);
      inner = createFor(builder, loc, from, to);
      ivs.push_back(inner.getInductionVar());
      builder.setInsertionPointToStart(inner.getBody());
    }
    moveBody(loop, inner, ivs);
    return endBlock(inner);
  }

  Value extent = box.extent.back();
  Value firstRow = begin, endRow = end;
  if (!byRows) {
    firstRow = math.div(begin, extent);
    endRow = math.div(math.add(end, math.sub(extent, 1)), extent);
  }
  auto rows = createFor(builder, loc, firstRow, endRow);
  builder.setInsertionPointToStart(rows.getBody());
  Value row = rows.getInductionVar();
  SmallVector<Value> ivs = delinearize(builder, loc, box, row);
  Value from = lower, to = box.upper.back();
  if (!byRows) {
    Value start = math.mul(row, extent);
    from = math.add(lower, math.max(math.sub(begin, start), math.constant(0)));
    to = math.add(lower, math.min(math.sub(end, start), extent));
  }
  if (cutsRows)
    enterBlocks(from, to);
  auto inner = createFor(builder, loc, from, to);
  ivs.push_back(inner.getInductionVar());
  moveBody(loop, inner, ivs);
  endBlock(inner);
}

/// Like emitPartition, for a range of chunks of `length` out of `count`
/// iterations, with sums in the order of all targets. Rows and lanes cut a
/// chunk into pieces in which consecutive iterations belong to consecutive
/// lanes.
static void emitChunks(OpBuilder &builder, ParallelForOp loop, const Box &box,
                       Value count, Value length, Value begin, Value end,
                       Accumulators &accumulators) {
  Location loc = loop.getLoc();
  IndexMath math(builder, loc);
  auto chunks = createFor(builder, loc, begin, end);
  builder.setInsertionPointToStart(chunks.getBody());
  Value chunk = chunks.getInductionVar();
  accumulators.emitChunkStart(builder, loc);
  Value first = math.mul(chunk, length);
  // The remaining number is added to `first`, which is in range, so that no sum
  // can overflow.
  Value last = math.add(first, math.min(length, math.sub(count, first)));
  OpBuilder atEnd(chunks.getBody()->getTerminator());

  Value extent = box.extent.back(), lower = box.lower.back();
  SmallVector<Value> ivs;
  Value start = math.constant(0);
  if (box.rank() > 1) {
    auto rows =
        createFor(builder, loc, math.div(first, extent),
                  math.div(math.add(last, math.sub(extent, 1)), extent));
    builder.setInsertionPointToStart(rows.getBody());
    ivs = delinearize(builder, loc, box, rows.getInductionVar());
    start = math.mul(rows.getInductionVar(), extent);
  }
  // The iterations of this row (along the last dimension) in this chunk, by
  // their linear numbers.
  Value from = math.max(start, first);
  Value to = math.min(math.add(start, extent), last);
  auto pieces =
      createFor(builder, loc, math.div(from, SumOrder::kLanes),
                math.div(math.add(to, math.constant(SumOrder::kLanes - 1)),
                         SumOrder::kLanes));
  builder.setInsertionPointToStart(pieces.getBody());
  Value piece = math.mul(pieces.getInductionVar(), SumOrder::kLanes);
  from = math.max(from, piece);
  to = math.min(to, math.add(piece, math.constant(SumOrder::kLanes)));
  // The difference between the index of an iteration and its linear number.
  Value shift = math.sub(lower, start);
  Value firstLane = math.add(piece, shift);
  auto inner =
      createFor(builder, loc, math.add(from, shift), math.add(to, shift));
  ivs.push_back(inner.getInductionVar());
  accumulators.setLanes(inner, firstLane);
  moveBody(loop, inner, ivs);
  accumulators.emitChunkEnd(atEnd, loc, chunk);
}

LogicalResult
tai::lowerParallelFor(ParallelForOp loop, Value frame, StringRef name,
                      ModuleLowering &lowering,
                      SmallVectorImpl<LLVM::LLVMFuncOp> &functions) {
  if (loop.isStructFor())
    return loop.emitOpError("runs over a field; expects a box, as "
                            "tai-lower-struct-for makes it");
  Location loc = loop.getLoc();
  RuntimeCalls &runtime = lowering.runtime;
  numberDraws(loop, loop);

  OpBuilder builder(loop);
  IndexMath math(builder, loc);
  Box box(loop, builder);
  std::optional<int64_t> total = box.constantCount(box.rank());
  bool isOrdered = !(total && *total == 0) && hasCommonTotals(loop);
  if (loop.getSerialize() || loop->getParentOfType<ParallelForOp>() ||
      (total && *total <= 1 && !isOrdered)) {
    return ::lowerSerially(loop, box, lowering.fields);
  }
  FailureOr<Accumulators> accumulators = Accumulators::collect(loop, lowering);
  if (failed(accumulators))
    return failure();

  // The unit in which a partition is counted: rows of iterations, or single
  // iterations.
  std::optional<int64_t> rows = box.constantCount(box.rank() - 1);
  std::optional<int64_t> rowLength = getConstantIntValue(box.extent.back());
  bool byRows = box.rank() > 1 && rows && *rows >= kManyRows && rowLength;
  // If the number of partitions determines the bits of a sum, which are fixed,
  // the estimate must not use analysis results that a pass may drop.
  bool isFixed = loop.getOrder().has_value();
  bool reduces = !accumulators->empty();
  double cost = estimateIteration(
      loop, (reduces && isFixed) || loop->hasAttr(kIndependentAttrName));
  if (FloatAttr fixed = loop.getFixedCostAttr())
    cost = fixed.getValueAsDouble();
  // The number of iterations in one unit of the partition.
  double perStep = byRows ? double(*rowLength) : 1.0;
  size_t counted = byRows ? box.rank() - 1 : box.rank();
  if (IntegerAttr outer = loop.getOuterDimsAttr()) {
    counted = outer.getInt();
    for (Value extent : ArrayRef(box.extent).drop_front(counted))
      perStep *= getConstantIntValue(extent).value_or(1);
    byRows = false;
  }
  Value iterations, length;
  if (isOrdered) {
    // A partition counts chunks.
    perStep = double(SumOrder::kLanes);
    iterations = box.count(box.rank(), builder, loc);
    length = emitChunkLength(builder, loc, iterations);
  }
  cost *= perStep;
  Value count =
      isOrdered ? math.toI64(math.div(math.add(iterations, math.sub(length, 1)),
                                      length))
                : math.toI64(box.count(counted, builder, loc));

  Type pointer = runtime.getPointerType();
  Type i64 = builder.getI64Type();
  auto function = createFunction(lowering.module, loc, name, Type(),
                                 {pointer, pointer, i64, i64, i64},
                                 /*isInternal=*/true);
  functions.push_back(function);

  // A box without iterations is skipped, because rows of length zero would
  // cause a division by zero.
  if (!total) {
    Value zero = runtime.i64(builder, loc, 0);
    Value some = arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::sgt,
                                       count, zero);
    auto guard = scf::IfOp::create(builder, loc, some);
    loop->moveBefore(guard.thenBlock(), guard.thenBlock()->begin());
    builder.setInsertionPoint(loop);
  }

  Value fixed =
      runtime.i32(builder, loc, isFixed ? int(kPartsFixed) : int(reduces));
  Value nanoseconds =
      runtime.i64(builder, loc, std::max<int64_t>(1, std::llround(cost)));
  if (isOrdered)
    nanoseconds =
        arith::MulIOp::create(builder, loc, nanoseconds,
                              math.toI64(math.div(length, SumOrder::kLanes)));
  Value parts =
      runtime.tai_rt_parts(builder, loc, frame, count, nanoseconds, fixed);
  if (reduces) {
    parts = accumulators->limitParts(builder, loc, parts, count, perStep);
    accumulators->emitBefore(builder, loc, frame, parts);
  }

  Closure closure(function, frame, loop);
  Block *entry = &function.getBody().front();
  OpBuilder inside = OpBuilder::atBlockEnd(entry);
  accumulators->emitEntry(inside, loc, entry->getArgument(4));
  auto ret = LLVM::ReturnOp::create(inside, loc, ValueRange());
  inside.setInsertionPoint(ret);
  IndexMath insideMath(inside, loc);
  Value begin = insideMath.toIndex(entry->getArgument(2));
  Value end = insideMath.toIndex(entry->getArgument(3));
  if (isOrdered)
    emitChunks(inside, loop, box, iterations, length, begin, end,
               *accumulators);
  else
    emitPartition(inside, loop, box, begin, end, byRows, *accumulators);
  accumulators->rewriteUpdates();
  inside.setInsertionPoint(ret);
  accumulators->emitExit(inside, loc);
  if (failed(closure.capture(function.getBody())))
    return failure();

  Value address = LLVM::AddressOfOp::create(builder, loc, function);
  Value environment = closure.emit(runtime);
  runtime.tai_rt_parallel_for(builder, loc, frame, address, environment, count,
                              parts);
  accumulators->emitAfter(builder, loc, frame, parts);
  if (isOrdered)
    accumulators->emitAfterChunks(builder, loc, math.toIndex(count));
  loop.erase();
  return success();
}
