//===- TraceSegments.cpp - Traces of a part of a loop ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A gradient that runs its function again has a loop that records values, and
// another one that takes them in reverse. The records of all iterations may
// take more memory than is allowed. Then the loops are divided into segments:
// a first run keeps the arrays that the loop changes at the start of each
// segment, and the reverse sweep runs one segment after the other again, from
// the last to the first, with the records of this segment alone.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/ViewLikeInterface.h"
#include "tai/AD/Foreign/Traces.h"
#include "llvm/ADT/MapVector.h"
#include "llvm/ADT/SetVector.h"

using namespace mlir;
using namespace mlir::tai;

static std::optional<int64_t> getConstant(Value value) {
  APInt constant;
  if (matchPattern(value, m_ConstantInt(&constant)))
    return constant.getSExtValue();
  return std::nullopt;
}

static uint64_t getBytes(Type type) {
  if (type.isIndex())
    return 8;
  if (auto vector = dyn_cast<VectorType>(type))
    return vector.getNumElements() * getBytes(vector.getElementType());
  return (type.getIntOrFloatBitWidth() + 7) / 8;
}

static bool hasBytes(Type type) {
  if (auto vector = dyn_cast<VectorType>(type))
    return !vector.isScalable() && hasBytes(vector.getElementType());
  return type.isIntOrIndexOrFloat();
}

std::optional<uint64_t> tai::getAllocatedBytes(memref::AllocOp array) {
  MemRefType type = array.getType();
  if (!hasBytes(type.getElementType()))
    return std::nullopt;
  uint64_t bytes = getBytes(type.getElementType());
  for (int64_t extent : type.getShape())
    if (!ShapedType::isDynamic(extent))
      bytes *= extent;
  for (Value extent : array.getDynamicSizes()) {
    std::optional<int64_t> constant = getConstant(extent);
    if (!constant)
      return std::nullopt;
    bytes *= *constant;
  }
  return bytes;
}

/// The number of iterations of a loop with constant bounds.
static std::optional<int64_t> getTrips(scf::ForOp loop) {
  auto lower = getConstant(loop.getLowerBound()),
       upper = getConstant(loop.getUpperBound()),
       step = getConstant(loop.getStep());
  if (!lower || !upper || !step || *step <= 0 || *upper <= *lower)
    return std::nullopt;
  return llvm::divideCeil(*upper - *lower, *step);
}

/// The array that `value` is, or is a view of.
static Value getArray(Value value) {
  while (auto view = value.getDefiningOp<ViewLikeOpInterface>())
    value = view.getViewSource();
  return value;
}

namespace {
/// The loop with records, the loop that takes them, and the arrays of both.
struct Segmented {
  scf::ForOp forward, reverse;
  int64_t trips = 0;
  /// Traces of the loop, and their numbers of elements for one iteration.
  llvm::MapVector<Value, int64_t> traces;
  /// Arrays that the loop changes and that exist before it.
  llvm::SetVector<Value> state;
  /// Arrays that a run of a segment needs.
  llvm::SetVector<Value> read;
};

class Segmenter {
public:
  Segmenter(FunctionOpInterface gradient, ArrayRef<Value> traces)
      : body(gradient.getFunctionBody().front()), all(traces),
        b(gradient.getLoc(), gradient.getContext()) {}

  LogicalResult run(uint64_t limit);

private:
  bool findLoops();
  bool findState();
  bool isAfter(Operation *op, Operation *other) {
    Operation *outer = body.findAncestorOpInBlock(*op);
    return outer != other && other->isBeforeInBlock(outer);
  }
  void shift(scf::ForOp loop, Value first);
  void copy(Value array, Value kept, Value segment, bool restores);
  scf::ForOp cloneRange(scf::ForOp loop, Value from, Value to,
                        ValueRange inits);
  void rewrite(int64_t length);

  Value constant(int64_t value) {
    return arith::ConstantIndexOp::create(b, value);
  }
  Value multiply(Value value, int64_t factor) {
    return b.createOrFold<arith::MulIOp>(value, constant(factor));
  }

  Block &body;
  ArrayRef<Value> all;
  ImplicitLocOpBuilder b;
  Segmented found;
};
} // namespace

/// Finds the pair of loops whose records take most memory.
bool Segmenter::findLoops() {
  llvm::MapVector<Operation *, Segmented> pairs;
  for (Value trace : all) {
    auto alloc = trace.getDefiningOp<memref::AllocOp>();
    if (!alloc || alloc->getBlock() != &body ||
        alloc.getDynamicSizes().size() != 1)
      continue;
    std::optional<int64_t> count = getConstant(alloc.getDynamicSizes()[0]);
    scf::ForOp forward, reverse;
    bool fits = count.has_value();
    for (Operation *user : trace.getUsers()) {
      Operation *outer = body.findAncestorOpInBlock(*user);
      auto loop = dyn_cast<scf::ForOp>(outer);
      if (isa<memref::DeallocOp>(user) && user == outer)
        continue;
      scf::ForOp &known = isa<memref::StoreOp>(user) ? forward : reverse;
      fits &= loop && isa<memref::StoreOp, memref::LoadOp>(user) &&
              (!known || known == loop);
      known = loop;
    }
    if (!fits || !forward || !reverse || forward == reverse)
      continue;
    std::optional<int64_t> trips = getTrips(forward);
    if (!trips || getTrips(reverse) != trips || *count % *trips != 0)
      continue;
    Segmented &pair = pairs[forward];
    if (pair.reverse && pair.reverse != reverse)
      return false;
    pair.forward = forward;
    pair.reverse = reverse;
    pair.trips = *trips;
    pair.traces[trace] = *count / *trips;
  }
  auto getWeight = [](const Segmented &pair) {
    uint64_t bytes = 0;
    for (auto &[trace, count] : pair.traces)
      bytes += count * pair.trips *
               getBytes(cast<MemRefType>(trace.getType()).getElementType());
    return bytes;
  };
  for (auto &[loop, pair] : pairs)
    if (!found.forward || getWeight(pair) > getWeight(found))
      found = pair;
  return bool(found.forward);
}

/// Finds the arrays that the loop changes. False if running a part of the loop
/// again would find other contents in an array.
bool Segmenter::findState() {
  llvm::SetVector<Value> written;
  WalkResult result = found.forward->walk([&](Operation *op) {
    // A trace of other loops gets the same values again.
    auto add = [&](Value value, llvm::SetVector<Value> &to) {
      value = getArray(value);
      if (!found.forward->isAncestor(value.getParentBlock()->getParentOp()) &&
          !llvm::is_contained(all, value))
        to.insert(value);
    };
    if (auto store = dyn_cast<memref::StoreOp>(op)) {
      add(store.getMemref(), written);
    } else if (auto atomic = dyn_cast<memref::AtomicRMWOp>(op)) {
      add(atomic.getMemref(), written);
    } else if (auto load = dyn_cast<memref::LoadOp>(op)) {
      add(load.getMemref(), found.read);
    } else if (auto copy = dyn_cast<memref::CopyOp>(op)) {
      add(copy.getTarget(), written);
      add(copy.getSource(), found.read);
    } else if (!op->hasTrait<OpTrait::HasRecursiveMemoryEffects>() &&
               !isMemoryEffectFree(op) &&
               !isa<memref::AllocOp, memref::AllocaOp, memref::DeallocOp>(op)) {
      return WalkResult::interrupt();
    }
    return WalkResult::advance();
  });
  if (result.wasInterrupted())
    return false;
  for (Type type : found.forward.getResultTypes())
    if (!hasBytes(type))
      return false;
  for (Value array : written) {
    auto type = cast<MemRefType>(array.getType());
    Operation *op = array.getDefiningOp();
    if (!isa_and_nonnull<memref::AllocOp, memref::AllocaOp>(op) ||
        !type.hasStaticShape() || !hasBytes(type.getElementType()))
      return false;
    found.state.insert(array);
    found.read.insert(array);
  }
  // After the loop, nothing may change an array that it only reads. The reverse
  // sweep may not read an array that it changes.
  for (Value array : found.read) {
    SmallVector<Value> views{array};
    while (!views.empty()) {
      Value view = views.pop_back_val();
      for (Operation *user : view.getUsers()) {
        if (isa<ViewLikeOpInterface>(user))
          views.push_back(user->getResult(0));
        if (!isAfter(user, found.forward) || isa<memref::DeallocOp>(user))
          continue;
        // Each segment restores the arrays that the loop changes.
        bool isAllowed =
            found.state.contains(array)
                ? body.findAncestorOpInBlock(*user)->isBeforeInBlock(
                      found.reverse)
                : isa<memref::LoadOp>(user);
        if (!isAllowed && !isa<memref::DimOp, ViewLikeOpInterface>(user))
          return false;
      }
    }
  }
  return true;
}

/// Makes `loop` access the traces of a segment, which begin with the records of
/// iteration `first`.
void Segmenter::shift(scf::ForOp loop, Value first) {
  OpBuilder::InsertionGuard guard(b);
  loop->walk([&](Operation *op) {
    auto load = dyn_cast<memref::LoadOp>(op);
    auto store = dyn_cast<memref::StoreOp>(op);
    Value array = load ? load.getMemref() : store ? store.getMemref() : Value();
    auto *trace = array ? found.traces.find(array) : found.traces.end();
    if (trace == found.traces.end())
      return;
    b.setInsertionPoint(op);
    OpOperand &index =
        load ? load.getIndicesMutable()[0] : store.getIndicesMutable()[0];
    index.set(b.createOrFold<arith::SubIOp>(index.get(),
                                            multiply(first, trace->second)));
  });
}

/// Copies `array` to its place for `segment` in the array `kept`, or back.
void Segmenter::copy(Value array, Value kept, Value segment, bool restores) {
  auto type = cast<MemRefType>(array.getType());
  SmallVector<Value> lower, upper, step;
  for (int64_t extent : type.getShape()) {
    lower.push_back(constant(0));
    upper.push_back(constant(extent));
    step.push_back(constant(1));
  }
  scf::buildLoopNest(
      b, b.getLoc(), lower, upper, step,
      [&](OpBuilder &inner, Location loc, ValueRange ivs) {
        SmallVector<Value> indices{segment};
        llvm::append_range(indices, ivs);
        Value element = restores
                            ? memref::LoadOp::create(inner, loc, kept, indices)
                            : memref::LoadOp::create(inner, loc, array, ivs);
        if (restores)
          memref::StoreOp::create(inner, loc, element, array, ivs);
        else
          memref::StoreOp::create(inner, loc, element, kept, indices);
      });
}

/// A copy of `loop` for the iterations `from` to `to`.
scf::ForOp Segmenter::cloneRange(scf::ForOp loop, Value from, Value to,
                                 ValueRange inits) {
  int64_t step = *getConstant(loop.getStep());
  Type type = loop.getLowerBound().getType();
  auto getBound = [&](Value number) {
    Value scaled = multiply(number, step);
    if (!type.isIndex())
      scaled = arith::IndexCastOp::create(b, type, scaled);
    return b.createOrFold<arith::AddIOp>(scaled, loop.getLowerBound());
  };
  Value lower = getBound(from), upper = getBound(to);
  auto made = cast<scf::ForOp>(b.clone(*loop));
  made.setLowerBound(lower);
  made.setUpperBound(upper);
  made.getInitArgsMutable().assign(inits);
  return made;
}

/// Divides the loops into segments of `length` iterations.
void Segmenter::rewrite(int64_t length) {
  int64_t count = llvm::divideCeil(found.trips, length);
  scf::ForOp forward = found.forward, reverse = found.reverse;
  b.setLoc(forward.getLoc());
  b.setInsertionPoint(forward);
  // Pairs of a value at the start of a segment, or an array, and where it is
  // kept.
  SmallVector<std::pair<Value, Value>> arrays;
  SmallVector<Value> numbers;
  auto keep = [&](Type element, ArrayRef<int64_t> shape) -> Value {
    SmallVector<int64_t> extents{count};
    llvm::append_range(extents, shape);
    return memref::AllocOp::create(b, MemRefType::get(extents, element));
  };
  for (Value array : found.state) {
    auto type = cast<MemRefType>(array.getType());
    arrays.emplace_back(array, keep(type.getElementType(), type.getShape()));
  }
  for (Type type : forward.getResultTypes())
    numbers.push_back(keep(type, {}));
  // The first and the last iteration of a segment.
  auto getRange = [&](Value segment) -> std::pair<Value, Value> {
    Value first = multiply(segment, length);
    Value last = b.createOrFold<arith::MinSIOp>(
        b.createOrFold<arith::AddIOp>(first, constant(length)),
        constant(found.trips));
    return {first, last};
  };
  Value zero = constant(0), one = constant(1), segments = constant(count);
  auto all = scf::ForOp::create(b, zero, segments, one, forward.getInitArgs());
  if (all.getNumResults() == 0)
    all.getBody()->getTerminator()->erase();
  b.setInsertionPointToEnd(all.getBody());
  for (auto &[array, kept] : arrays)
    copy(array, kept, all.getInductionVar(), /*restores=*/false);
  for (auto [value, kept] : llvm::zip(all.getRegionIterArgs(), numbers))
    memref::StoreOp::create(b, value, kept, all.getInductionVar());
  auto [first, last] = getRange(all.getInductionVar());
  scf::ForOp part = cloneRange(forward, first, last, all.getRegionIterArgs());
  part->walk([&](memref::StoreOp store) {
    if (found.traces.contains(store.getMemref()))
      store.erase();
  });
  scf::YieldOp::create(b, part.getResults());

  b.setInsertionPoint(reverse);
  b.setLoc(reverse.getLoc());
  auto back = scf::ForOp::create(b, zero, segments, one, reverse.getInitArgs());
  if (back.getNumResults() == 0)
    back.getBody()->getTerminator()->erase();
  b.setInsertionPointToEnd(back.getBody());
  Value segment = b.createOrFold<arith::SubIOp>(constant(count - 1),
                                                back.getInductionVar());
  for (auto &[array, kept] : arrays)
    copy(array, kept, segment, /*restores=*/true);
  SmallVector<Value> inits;
  for (Value kept : numbers)
    inits.push_back(memref::LoadOp::create(b, kept, segment));
  auto [begin, end] = getRange(segment);
  shift(cloneRange(forward, begin, end, inits), begin);
  Value trips = constant(found.trips);
  scf::ForOp taken = cloneRange(
      reverse, b.createOrFold<arith::SubIOp>(trips, end),
      b.createOrFold<arith::SubIOp>(trips, begin), back.getRegionIterArgs());
  shift(taken, begin);
  scf::YieldOp::create(b, taken.getResults());

  // Memory that a segment needs is freed after the last one.
  Operation *after = back;
  for (Value array : found.read)
    for (Operation *user : llvm::make_early_inc_range(array.getUsers()))
      if (isa<memref::DeallocOp>(user) && user->getBlock() == &body &&
          isAfter(user, forward) && user->isBeforeInBlock(back)) {
        user->moveAfter(after);
        after = user;
      }
  b.setInsertionPointAfter(after);
  for (auto &[array, kept] : arrays)
    memref::DeallocOp::create(b, kept);
  for (Value kept : numbers)
    memref::DeallocOp::create(b, kept);
  forward.replaceAllUsesWith(all.getResults());
  reverse.replaceAllUsesWith(back.getResults());
  forward.erase();
  reverse.erase();
  for (auto &[trace, inner] : found.traces) {
    auto alloc = trace.getDefiningOp<memref::AllocOp>();
    b.setInsertionPoint(alloc);
    alloc.getDynamicSizesMutable().assign(constant(inner * length));
  }
}

LogicalResult Segmenter::run(uint64_t limit) {
  if (!findLoops() || !findState())
    return failure();
  uint64_t fixed = 0, perSegment = 0, perIteration = 0;
  for (auto &[trace, count] : found.traces)
    perIteration +=
        count * getBytes(cast<MemRefType>(trace.getType()).getElementType());
  for (Value array : found.state) {
    auto type = cast<MemRefType>(array.getType());
    perSegment += type.getNumElements() * getBytes(type.getElementType());
  }
  for (Type type : found.forward.getResultTypes())
    perSegment += getBytes(type);
  for (memref::AllocOp array : body.getOps<memref::AllocOp>()) {
    // Adjoints of arrays are no records.
    if (found.traces.contains(array) ||
        (!llvm::is_contained(all, array.getResult()) &&
         !found.state.contains(array)))
      continue;
    std::optional<uint64_t> bytes = getAllocatedBytes(array);
    if (!bytes)
      return failure();
    fixed += *bytes;
  }
  // The longest segments that fit: the fewest copies.
  for (int64_t length = found.trips - 1; length > 0; --length) {
    int64_t count = llvm::divideCeil(found.trips, length);
    if (fixed + count * perSegment + length * perIteration > limit)
      continue;
    rewrite(length);
    return success();
  }
  return failure();
}

LogicalResult tai::divideTraces(FunctionOpInterface gradient,
                                ArrayRef<Value> traces, uint64_t limit) {
  return Segmenter(gradient, traces).run(limit);
}
