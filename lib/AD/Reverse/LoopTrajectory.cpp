//===- LoopTrajectory.cpp - Recording of loops, checkpointed --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Reverse/LoopTrajectory.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/CarriedValues.h"
#include "llvm/Support/MathExtras.h"

using namespace mlir;
using namespace mlir::tai;

// A vector is stored component by component, so that the lowering of the
// adjoint need not support memrefs of vectors.

static MemRefType getHistoryType(Type type) {
  SmallVector<int64_t> shape = {ShapedType::kDynamic};
  if (auto vector = dyn_cast<VectorType>(type))
    shape.push_back(vector.getNumElements());
  return MemRefType::get(shape, getElementTypeOrSelf(type));
}

/// True for numbers and for vectors of a fixed number of numbers. Carried
/// values of other types have no representation in memory here.
static bool canRecord(Type type) {
  if (auto vector = dyn_cast<VectorType>(type)) {
    if (vector.isScalable())
      return false;
    type = vector.getElementType();
  }
  return type.isIntOrIndexOrFloat();
}

/// Reports a carried value of a type that cannot be recorded.
static LogicalResult checkRecordable(AdjointBuilder &b, Operation *loop,
                                     Type type) {
  if (canRecord(type))
    return success();
  b.emitError(loop, "the gradient needs the values that this loop carries, but "
                    "those of type ")
          .append(type, " cannot be recorded")
          .attachNote()
      << "carry numbers, or vectors of a fixed length: the parts of a complex "
         "number, say, or the elements of a tensor";
  return failure();
}

int64_t LoopTrajectory::getBytes(Type type) {
  if (!canRecord(type))
    return 0;
  Type element = getElementTypeOrSelf(type);
  int64_t bytes = element.isIndex()
                      ? 8
                      : llvm::divideCeil(element.getIntOrFloatBitWidth(), 8);
  auto vector = dyn_cast<VectorType>(type);
  return vector ? bytes * vector.getNumElements() : bytes;
}

static void storeState(AdjointBuilder &b, Value value, Value buffer,
                       Value position) {
  auto vector = dyn_cast<VectorType>(value.getType());
  if (!vector) {
    memref::StoreOp::create(b, value, buffer, position);
    return;
  }
  for (int64_t i = 0, e = vector.getNumElements(); i != e; ++i)
    memref::StoreOp::create(
        b, b.createExtract(value, i), buffer,
        ValueRange{position, arith::ConstantIndexOp::create(b, i)});
}

static Value loadState(AdjointBuilder &b, Type type, Value buffer,
                       Value position) {
  auto vector = dyn_cast<VectorType>(type);
  if (!vector)
    return memref::LoadOp::create(b, buffer, position);
  SmallVector<Value> components;
  for (int64_t i = 0, e = vector.getNumElements(); i != e; ++i)
    components.push_back(memref::LoadOp::create(
        b, buffer, ValueRange{position, arith::ConstantIndexOp::create(b, i)}));
  return b.createVector(vector, components);
}

// Loads the value of carried value `index` from its buffer. `record` later sets
// the size of the buffer and emits the stores to it, when the reverse is
// complete.
Value LoopTrajectory::load(Frame &frame, unsigned index,
                           const ReverseDraft &draft) {
  Type type = forward.getRegionIterArg(index).getType();
  if (failed(checkRecordable(b, loop, type)))
    return {};
  memref::AllocOp &buffer = histories[index];
  if (!buffer) {
    b.setInsertionPoint(forward);
    buffer = memref::AllocOp::create(b, getHistoryType(type), count);
  }
  b.setInsertionPoint(frame.recomputeBegin);
  return loadState(b, type, buffer, draft.local->getResult(0));
}

int64_t LoopTrajectory::getBytesPerIteration() {
  int64_t bytes = 0;
  for (auto [index, buffer] : histories)
    bytes += getBytes(forward.getRegionIterArg(index).getType());
  return bytes;
}

/// Emits, at the start of the body of `recorder`, stores of the recorded values
/// to their buffers, at the number of the iteration. The distance of the
/// induction variable from the lower bound is unsigned, because it may exceed
/// the range of its signed type.
void LoopTrajectory::storeRecorded(scf::ForOp recorder) {
  b.setInsertionPointToStart(recorder.getBody());
  Value position = recorder.getInductionVar();
  if (!matchPattern(recorder.getLowerBound(), m_Zero()))
    position = arith::SubIOp::create(b, position, recorder.getLowerBound());
  if (!matchPattern(recorder.getStep(), m_One()))
    position = arith::DivUIOp::create(b, position, recorder.getStep());
  if (!position.getType().isIndex())
    position = arith::IndexCastUIOp::create(b, b.getIndexType(), position);
  for (auto [index, buffer] : histories)
    storeState(b, recorder.getRegionIterArg(index), buffer, position);
}

/// True if `value`, used in `block`, can be computed before the loop whose body
/// is `block`: by at most `depth` levels of ops without side effects.
static bool canLeave(Value value, Block *block, unsigned depth) {
  if (value.getParentBlock() != block)
    return true;
  Operation *op = value.getDefiningOp();
  return op && depth != 0 && op->getNumRegions() == 0 &&
         isMemoryEffectFree(op) && isSpeculatable(op) &&
         llvm::all_of(op->getOperands(), [&](Value operand) {
           return canLeave(operand, block, depth - 1);
         });
}

/// Emits the size and the number of chunks for `trips` iterations. The size is
/// the square root of `trips`, but at least `most`. An integer division is
/// avoided, because it could not be hoisted out of a loop around this one.
static std::pair<Value, Value> createSquareRoots(AdjointBuilder &b, Value trips,
                                                 Value most) {
  Type integer = b.getI64Type(), real = b.getF64Type();
  auto toReal = [&](Value index) -> Value {
    return arith::SIToFPOp::create(
        b, real, arith::IndexCastOp::create(b, integer, index));
  };
  auto toIndex = [&](Value number) -> Value {
    return arith::IndexCastOp::create(
        b, b.getIndexType(),
        arith::FPToSIOp::create(b, integer, math::CeilOp::create(b, number)));
  };
  Value size = arith::MaxSIOp::create(
      b, toIndex(math::SqrtOp::create(b, toReal(trips))), most);
  Value number = toIndex(arith::DivFOp::create(b, toReal(trips), toReal(size)));
  return {size, number};
}

/// Emits the size and the number of chunks; null values if one chunk is enough.
LoopTrajectory::Chunks LoopTrajectory::createChunks() {
  int64_t limit = std::max<int64_t>(1, b.getPlan().options.historyBytes /
                                           getBytesPerIteration());
  APInt constant;
  if (matchPattern(count, m_ConstantInt(&constant))) {
    int64_t trips = std::max<int64_t>(constant.getSExtValue(), 0);
    if (trips <= limit)
      return {};
    int64_t size = std::max(
        limit, static_cast<int64_t>(std::ceil(std::sqrt(double(trips)))));
    Value chunk = arith::ConstantIndexOp::create(b, size);
    return {chunk,
            arith::ConstantIndexOp::create(b, llvm::divideCeil(trips, size)),
            chunk};
  }
  Value zero = arith::ConstantIndexOp::create(b, 0);
  Value one = arith::ConstantIndexOp::create(b, 1);
  Value trips = arith::MaxSIOp::create(b, count, zero);
  Value most = arith::ConstantIndexOp::create(b, limit);
  Value size, number;
  if (canLeave(count, forward->getBlock(), /*depth=*/8)) {
    std::tie(size, number) = createSquareRoots(b, trips, most);
  } else {
    Value isLong =
        arith::CmpIOp::create(b, arith::CmpIPredicate::sgt, trips, most);
    auto choice =
        scf::IfOp::create(b, TypeRange{b.getIndexType(), b.getIndexType()},
                          isLong, /*withElseRegion=*/true);
    OpBuilder::InsertionGuard guard(b);
    b.setInsertionPointToStart(choice.thenBlock());
    std::tie(size, number) = createSquareRoots(b, trips, most);
    scf::YieldOp::create(b, ValueRange{size, number});
    b.setInsertionPointToStart(choice.elseBlock());
    number = arith::MinSIOp::create(b, trips, one);
    scf::YieldOp::create(b, ValueRange{most, number});
    size = choice.getResult(0), number = choice.getResult(1);
  }
  return {size, number, arith::MinSIOp::create(b, trips, size)};
}

void LoopTrajectory::record() {
  if (histories.empty())
    return;
  OpBuilder::InsertionGuard guard(b);
  b.setInsertionPoint(forward);
  if (auto forOp = dyn_cast<scf::ForOp>(loop)) // known to the sweep only
    count = b.createTripCount(forOp);
  chunks = createChunks();
  Value room = chunks.room;
  if (!room)
    room = b.createOrFold<arith::MaxSIOp>(count,
                                          arith::ConstantIndexOp::create(b, 0));
  // The buffer of a carried value holds its record for one chunk, and then its
  // checkpoints.
  if (chunks.number)
    room = b.createOrFold<arith::AddIOp>(room, chunks.number);
  for (auto [index, buffer] : histories) {
    buffer.getDynamicSizesMutable().assign(room);
    buffer->moveBefore(forward);
  }
  if (chunks.size)
    recordChunks();
  else
    storeRecorded(forward);
  if (SmallVectorImpl<Value> *made = b.getPlan().local.histories) {
    llvm::append_range(*made, llvm::make_second_range(histories));
    for (auto [index, start] : starts)
      if (!histories.contains(index))
        made->push_back(start);
  }
}

/// Emits the bounds of the loop's induction variable for the iterations number
/// `begin` to `end`.
std::pair<Value, Value> LoopTrajectory::createRange(Value begin, Value end) {
  auto forOp = dyn_cast<scf::ForOp>(loop);
  if (!forOp)
    return {begin, end};
  Value lower, upper, step;
  {
    auto scope = b.enter(around);
    lower = b.getPrimal(forOp.getLowerBound());
    upper = b.getPrimal(forOp.getUpperBound());
    step = b.getPrimal(forOp.getStep());
  }
  bool isUnit = matchPattern(step, m_One());
  auto scale = [&](Value position) {
    if (!lower.getType().isIndex())
      position = arith::IndexCastOp::create(b, lower.getType(), position);
    if (!isUnit)
      position = arith::MulIOp::create(b, position, step);
    if (!matchPattern(lower, m_Zero()))
      position = arith::AddIOp::create(b, lower, position);
    return position;
  };
  Value first = scale(begin), after = scale(end);
  // For the last chunk, the upper bound itself is used, because lower bound
  // plus end times step may exceed the range of the type.
  if (!isUnit)
    after = arith::SelectOp::create(
        b, arith::CmpIOp::create(b, arith::CmpIPredicate::eq, end, count),
        upper, after);
  return {first, after};
}

/// Turns the forward loop into a loop over chunks, which stores a checkpoint at
/// the start of each chunk, around a loop over the iterations of the chunk.
void LoopTrajectory::recordChunks() {
  inner =
      scf::ForOp::create(b, forward.getLowerBound(), forward.getUpperBound(),
                         forward.getStep(), forward.getInitArgs());
  inner.getRegion().takeBody(forward.getRegion());
  SmallVector<Type> types = {b.getIndexType()};
  llvm::append_range(types, inner.getResultTypes());
  Block *body = b.createBlock(&forward.getRegion(), {}, types,
                              SmallVector<Location>(types.size(), b.getLoc()));
  Value begin = arith::MulIOp::create(b, body->getArgument(0), chunks.size);
  Value end = arith::MinSIOp::create(
      b, arith::AddIOp::create(b, begin, chunks.size), count);
  auto [lower, upper] = createRange(begin, end);
  inner->moveBefore(body, body->end());
  inner.getInitArgsMutable().assign(body->getArguments().drop_front());
  inner.setLowerBound(lower);
  inner.setUpperBound(upper);
  b.setInsertionPointToEnd(body);
  scf::YieldOp::create(b, inner.getResults());
  b.setInsertionPoint(forward);
  forward.setLowerBound(arith::ConstantIndexOp::create(b, 0));
  forward.setUpperBound(chunks.number);
  forward.setStep(arith::ConstantIndexOp::create(b, 1));
  storeRecorded(inner);

  // A checkpoint consists of the carried values on which the record of the
  // chunk depends.
  LiveValues live(forward.getRegion());
  for (BlockArgument argument : inner.getRegionIterArgs()) {
    unsigned index = argument.getArgNumber() - 1;
    if (!live.isLive(argument) ||
        failed(checkRecordable(b, loop, argument.getType())))
      continue;
    memref::AllocOp start = histories.lookup(index);
    if (!start) {
      b.setInsertionPoint(forward);
      start = memref::AllocOp::create(b, getHistoryType(argument.getType()),
                                      chunks.number);
    }
    starts[index] = start;
    b.setInsertionPointToStart(forward.getBody());
    storeState(b, forward.getRegionIterArg(index), start,
               getStart(index, forward.getInductionVar()));
  }
}

/// Returns the position, in the buffer of carried value `index`, of the
/// checkpoint of chunk number `chunk`.
Value LoopTrajectory::getStart(unsigned index, Value chunk) {
  return histories.contains(index)
             ? arith::AddIOp::create(b, chunks.room, chunk).getResult()
             : chunk;
}

/// Moves the ops of the drafted reverse loop into `reverse`, with `yields` as
/// the values that it yields.
scf::ForOp LoopTrajectory::finishReverse(scf::ForOp reverse,
                                         ReverseDraft &draft,
                                         ArrayRef<Value> yields) {
  reverse.getRegion().takeBody(draft.loop.getRegion());
  OpBuilder::InsertionGuard guard(b);
  b.setInsertionPointToEnd(reverse.getBody());
  scf::YieldOp::create(b, yields);
  return reverse;
}

/// Emits the loop over chunks from the last to the first. The forward loop has
/// recorded the last chunk; each other chunk is recorded before the reverse of
/// its iterations.
scf::ForOp LoopTrajectory::createReverseChunks(ReverseDraft &draft,
                                               ArrayRef<Value> inits,
                                               ArrayRef<Value> yields) {
  Value zero = arith::ConstantIndexOp::create(b, 0);
  Value one = arith::ConstantIndexOp::create(b, 1);
  auto outer = scf::ForOp::create(b, zero, chunks.number, one, inits);
  if (!outer.getBody()->empty())
    outer.getBody()->back().erase();
  OpBuilder::InsertionGuard guard(b);
  b.setInsertionPointToEnd(outer.getBody());
  Value chunk = arith::SubIOp::create(
      b, arith::SubIOp::create(b, chunks.number, one), outer.getInductionVar());
  Value begin = arith::MulIOp::create(b, chunk, chunks.size);
  Value end = arith::MinSIOp::create(
      b, arith::AddIOp::create(b, begin, chunks.size), count);

  Value isLast = arith::CmpIOp::create(b, arith::CmpIPredicate::eq,
                                       outer.getInductionVar(), zero);
  Value rerunEnd = arith::SelectOp::create(b, isLast, begin, end);
  auto [lower, upper] = createRange(begin, rerunEnd);
  // Carried values without a checkpoint can start with any value: the ops that
  // use them do not influence the record, and will be dropped.
  SmallVector<Value> states(forward.getInitArgs());
  for (auto [index, start] : starts)
    states[index] = loadState(b, inner.getRegionIterArg(index).getType(), start,
                              getStart(index, chunk));
  IRMapping mapping;
  mapping.map(inner.getLowerBound(), lower);
  mapping.map(inner.getUpperBound(), upper);
  mapping.map(forward.getRegionIterArgs(), states);
  b.clone(*inner, mapping);

  Value length = arith::SubIOp::create(b, end, begin);
  auto reverse =
      scf::ForOp::create(b, zero, length, one, outer.getRegionIterArgs());
  draft.last->setOperand(0, length);
  draft.iteration->setOperand(1, begin);
  scf::YieldOp::create(b, reverse.getResults());
  finishReverse(reverse, draft, yields);
  return outer;
}

scf::ForOp LoopTrajectory::createReverse(ReverseDraft &draft,
                                         ArrayRef<Value> inits,
                                         ArrayRef<Value> yields) {
  if (isChunked())
    return createReverseChunks(draft, inits, yields);
  return finishReverse(scf::ForOp::create(b, draft.loop.getLowerBound(),
                                          draft.loop.getUpperBound(),
                                          draft.loop.getStep(), inits),
                       draft, yields);
}

void LoopTrajectory::release() {
  for (auto [index, start] : starts)
    if (!histories.contains(index))
      memref::DeallocOp::create(b, start);
  for (auto [index, history] : histories)
    memref::DeallocOp::create(b, history);
}
