//===- TraceSegments.cpp - Traces of a part of a loop ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A gradient that runs its function again has a loop that records values, and
// another one that takes them in reverse. Between them, loops may take the
// records in order, to recover the values that a loop carries, and record
// these. The records of all iterations may take more memory than is allowed.
// Then the loops are divided into segments: a first run keeps the arrays that
// the loop changes at the start of each segment, and the reverse sweep runs one
// segment after the other again, from the last to the first, with the records
// of this segment alone. If one iteration has too many records, its inner loops
// are divided in the same way.
//
//===----------------------------------------------------------------------===//

#include "TraceBytes.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/Interfaces/ViewLikeInterface.h"
#include "tai/AD/Foreign/Traces.h"
#include "llvm/ADT/MapVector.h"
#include "llvm/ADT/SetVector.h"

using namespace mlir;
using namespace mlir::tai;

/// The number of iterations of a loop with constant bounds.
static std::optional<int64_t> getTrips(scf::ForOp loop) {
  auto lower = getConstant(loop.getLowerBound()),
       upper = getConstant(loop.getUpperBound()),
       step = getConstant(loop.getStep());
  if (!lower || !upper || !step || *step <= 0 || *upper <= *lower)
    return std::nullopt;
  return llvm::divideCeil(*upper - *lower, *step);
}

/// True if a loop runs the iterations of another one from the last to the
/// first: its induction variable is only subtracted from the last number.
static bool isReversed(scf::ForOp loop) {
  return getConstant(loop.getLowerBound()) == 0 &&
         getConstant(loop.getStep()) == 1 &&
         !loop.getInductionVar().use_empty() &&
         llvm::all_of(loop.getInductionVar().getUses(), [](OpOperand &use) {
           return isa<arith::SubIOp>(use.getOwner()) &&
                  use.getOperandNumber() == 1;
         });
}

/// The array that `value` is, or is a view of.
static Value getArray(Value value) {
  while (auto view = value.getDefiningOp<ViewLikeOpInterface>())
    value = view.getViewSource();
  return value;
}

namespace {
/// An array with the records of a loop.
struct Record {
  memref::AllocOp array;
  scf::ForOp writer;
  llvm::SetVector<Operation *> readers;
};

/// The loops that are divided together, and the arrays of all of them.
struct Segmented {
  /// The loop that runs the function again, and that which takes the records
  /// from the last to the first.
  scf::ForOp forward, reverse;
  /// Loops between both, which take the records in order.
  SmallVector<scf::ForOp> replays;
  /// None if the number is known at run time only.
  std::optional<int64_t> trips;
  /// Records of the loops, and their positions for one iteration: a number, or
  /// none if it is known at run time only.
  llvm::MapVector<Value, std::optional<int64_t>> records;
  /// Arrays that the loop changes and that exist before it.
  llvm::SetVector<Value> state;
  /// Arrays that a run of a segment needs.
  llvm::SetVector<Value> read;
};

class Segmenter {
public:
  Segmenter(Block &body, ArrayRef<Value> records, ArrayRef<Value> all,
            StringRef name)
      : body(body), candidates(records), all(all), name(name),
        b(body.getParentOp()->getLoc(), body.getParentOp()->getContext()) {}

  LogicalResult run(int64_t limit);

private:
  bool findLoops();
  bool addReaders(Segmented &group, MutableArrayRef<Record> known,
                  scf::ForOp loop);
  bool findState();
  bool canStay(Value array, Operation *loop, bool isChanged);
  bool isAfter(Operation *op, Operation *other) {
    Operation *outer = body.findAncestorOpInBlock(*op);
    return outer && outer != other && other->isBeforeInBlock(outer);
  }
  bool isBeforeLoops(Value value) {
    return isDefinedBefore(value, found.forward);
  }
  scf::ForOp getFirstReader() {
    return found.replays.empty() ? found.reverse : found.replays.front();
  }
  void shift(scf::ForOp loop, Value first);
  void copy(Value array, Value kept, Value segment, bool restores);
  scf::ForOp cloneRange(scf::ForOp loop, Value from, Value to,
                        ValueRange inits);
  void makeLoop(scf::ForOp loop, ArrayRef<scf::ForOp> earlier, bool isReverse);
  void rewrite(Value segmentLength);
  LogicalResult runKnown(int64_t limit);
  LogicalResult runUnknown(int64_t limit);
  LogicalResult divideInner(int64_t limit);
  bool addBytes(Value array, TraceBytes &bytes) {
    return bytes.add(b, array, found.forward);
  }

  Value constant(int64_t value) {
    return arith::ConstantIndexOp::create(b, value);
  }
  Value multiply(Value value, Value factor) {
    return b.createOrFold<arith::MulIOp>(value, factor);
  }
  Value add(Value lhs, Value rhs) {
    return b.createOrFold<arith::AddIOp>(lhs, rhs);
  }
  Value divideUp(Value value, Value by) {
    Value more = b.createOrFold<arith::SubIOp>(by, constant(1));
    return b.createOrFold<arith::DivUIOp>(add(value, more), by);
  }
  Value toIndex(Value value) {
    return value.getType().isIndex()
               ? value
               : b.createOrFold<arith::IndexCastOp>(b.getIndexType(), value);
  }

  /// Where the values of the gradient are kept at the start of each segment.
  struct Kept {
    SmallVector<std::pair<Value, Value>> arrays;
    /// The numbers that each loop carries.
    DenseMap<Operation *, SmallVector<Value>> numbers;
  };

  Block &body;
  /// The arrays with records, and these together with copies.
  ArrayRef<Value> candidates, all;
  StringRef name;
  ImplicitLocOpBuilder b;
  Segmented found;
  // Values of the gradient, for `rewrite`.
  Value trips, length, count;
  DenseMap<Value, Value> perIteration;
  Kept kept;
  /// For each new loop over segments, its loops over the iterations of one.
  SmallVector<SmallVector<scf::ForOp>> inner;
};
} // namespace

/// The elements of `array` for one position of its first dimension.
static int64_t getRowElements(Value array) {
  int64_t elements = 1;
  for (int64_t extent :
       cast<MemRefType>(array.getType()).getShape().drop_front())
    elements *= extent;
  return elements;
}

static int64_t getRowBytes(Value array) {
  return getRowElements(array) *
         getBytes(cast<MemRefType>(array.getType()).getElementType());
}

/// Adds to `group` the arrays that `loop` records, and the loops that take
/// them. False if a loop cannot be divided with the others.
bool Segmenter::addReaders(Segmented &group, MutableArrayRef<Record> known,
                           scf::ForOp loop) {
  for (Record &record : known) {
    if (record.writer != loop)
      continue;
    Value array = record.array;
    std::optional<int64_t> positions =
        getConstant(record.array.getDynamicSizes()[0]);
    if (positions && group.trips) {
      if (*positions % *group.trips != 0)
        return false;
      *positions /= *group.trips;
    } else if (positions) {
      return false;
    }
    group.records[array] = positions;
    for (Operation *op : record.readers) {
      auto reader = cast<scf::ForOp>(op);
      if (!loop->isBeforeInBlock(reader))
        return false;
      bool isLast = isReversed(reader);
      std::optional<int64_t> count = getTrips(reader);
      if (count != group.trips)
        return false;
      if (isLast) {
        if (group.reverse && group.reverse != reader)
          return false;
        group.reverse = reader;
      } else if (!llvm::is_contained(group.replays, reader)) {
        group.replays.push_back(reader);
        if (!addReaders(group, known, reader))
          return false;
      }
    }
  }
  return true;
}

/// Finds the loops whose records take most memory.
bool Segmenter::findLoops() {
  SmallVector<Record> known;
  for (Value trace : candidates) {
    auto alloc = trace.getDefiningOp<memref::AllocOp>();
    if (!alloc || alloc.getDynamicSizes().size() != 1 ||
        !alloc.getType().isDynamicDim(0) ||
        !hasBytes(alloc.getType().getElementType()))
      continue;
    Record record{alloc, {}, {}};
    bool fits = true;
    for (Operation *user : trace.getUsers()) {
      Operation *outer = body.findAncestorOpInBlock(*user);
      if (isa<memref::DeallocOp>(user) && (!outer || user == outer))
        continue;
      auto loop = dyn_cast_or_null<scf::ForOp>(outer);
      if (loop && isa<memref::LoadOp>(user)) {
        record.readers.insert(loop);
        continue;
      }
      auto store = dyn_cast<memref::StoreOp>(user);
      fits &= loop && store && store.getMemref() == trace &&
              (!record.writer || record.writer == loop);
      record.writer = loop;
    }
    if (fits && record.writer && !record.readers.empty() &&
        !record.readers.contains(record.writer))
      known.push_back(record);
  }
  llvm::SetVector<Operation *> read;
  for (Record &record : known)
    read.insert_range(record.readers);
  int64_t most = -1;
  for (Record &record : known) {
    if (read.contains(record.writer))
      continue; // a replay
    Segmented group;
    group.forward = record.writer;
    group.trips = getTrips(record.writer);
    if (!group.trips && !getConstant(record.writer.getStep()))
      continue;
    if (!addReaders(group, known, record.writer) || !group.reverse)
      continue;
    llvm::sort(group.replays, [](scf::ForOp one, scf::ForOp other) {
      return one->isBeforeInBlock(other);
    });
    if (!group.replays.empty() &&
        !group.replays.back()->isBeforeInBlock(group.reverse))
      continue;
    int64_t weight = 0;
    for (auto &[array, positions] : group.records)
      weight += positions.value_or(1) * getRowBytes(array) *
                group.trips.value_or(int64_t(1) << 20);
    if (weight > most) {
      most = weight;
      found = group;
    }
  }
  return bool(found.forward);
}

/// True if the loops that run again after `loop` find in `array` the contents
/// that `loop` has found. Each segment restores an array that is changed.
bool Segmenter::canStay(Value array, Operation *loop, bool isChanged) {
  SmallVector<Value> views{array};
  while (!views.empty()) {
    Value view = views.pop_back_val();
    for (Operation *user : view.getUsers()) {
      if (isa<ViewLikeOpInterface>(user))
        views.push_back(user->getResult(0));
      if (!isAfter(user, loop) || isa<memref::DeallocOp>(user))
        continue;
      bool isAllowed = isChanged
                           ? body.findAncestorOpInBlock(*user)->isBeforeInBlock(
                                 getFirstReader())
                           : isa<memref::LoadOp>(user);
      if (!isAllowed && !isa<memref::DimOp, ViewLikeOpInterface>(user))
        return false;
    }
  }
  return true;
}

/// Finds the arrays that the loop changes. False if running a part of the loop
/// again would find other contents in an array.
bool Segmenter::findState() {
  llvm::SetVector<Value> written;
  auto visit = [&](scf::ForOp loop, llvm::SetVector<Value> &read,
                   llvm::SetVector<Value> &changed) {
    auto add = [&](Value value, llvm::SetVector<Value> &to) {
      value = getArray(value);
      // A record of other loops gets the same values again.
      if (!loop->isAncestor(value.getParentBlock()->getParentOp()) &&
          !llvm::is_contained(candidates, value))
        to.insert(value);
    };
    return !loop->walk([&](Operation *op) {
                  if (auto store = dyn_cast<memref::StoreOp>(op)) {
                    add(store.getMemref(), changed);
                  } else if (auto atomic = dyn_cast<memref::AtomicRMWOp>(op)) {
                    add(atomic.getMemref(), changed);
                  } else if (auto load = dyn_cast<memref::LoadOp>(op)) {
                    add(load.getMemref(), read);
                  } else if (auto copy = dyn_cast<memref::CopyOp>(op)) {
                    add(copy.getTarget(), changed);
                    add(copy.getSource(), read);
                  } else if (!op->hasTrait<
                                 OpTrait::HasRecursiveMemoryEffects>() &&
                             !isMemoryEffectFree(op) &&
                             !isa<memref::AllocOp, memref::AllocaOp,
                                  memref::DeallocOp>(op)) {
                    return WalkResult::interrupt();
                  }
                  return WalkResult::advance();
                })
                .wasInterrupted();
  };
  if (!visit(found.forward, found.read, written))
    return false;
  for (Value array : written) {
    auto type = cast<MemRefType>(array.getType());
    Operation *op = array.getDefiningOp();
    if (!isa_and_nonnull<memref::AllocOp, memref::AllocaOp>(op) ||
        !hasBytes(type.getElementType()) || !isBeforeLoops(array))
      return false;
    found.state.insert(array);
    found.read.insert(array);
  }
  for (Value array : found.read)
    if (!canStay(array, found.forward, found.state.contains(array)))
      return false;
  for (scf::ForOp replay : found.replays) {
    llvm::SetVector<Value> read, changed;
    if (!visit(replay, read, changed) || !changed.empty())
      return false;
    for (Value array : read)
      if (found.state.contains(array) ||
          !canStay(array, replay, /*isChanged=*/false))
        return false;
    found.read.insert_range(read);
  }
  // Numbers that loops carry are kept at the start of each segment.
  auto hasKnownNumbers = [](scf::ForOp loop) {
    return llvm::all_of(loop.getResultTypes(), hasBytes);
  };
  return hasKnownNumbers(found.forward) &&
         llvm::all_of(found.replays, hasKnownNumbers);
}

/// Makes `loop` access the records of a segment, which begin with those of
/// iteration `first`.
void Segmenter::shift(scf::ForOp loop, Value first) {
  OpBuilder::InsertionGuard guard(b);
  loop->walk([&](Operation *op) {
    auto load = dyn_cast<memref::LoadOp>(op);
    auto store = dyn_cast<memref::StoreOp>(op);
    Value array = load ? load.getMemref() : store ? store.getMemref() : Value();
    if (!array || !found.records.contains(array))
      return;
    b.setInsertionPoint(op);
    OpOperand &index =
        load ? load.getIndicesMutable()[0] : store.getIndicesMutable()[0];
    index.set(b.createOrFold<arith::SubIOp>(
        index.get(), multiply(first, perIteration.lookup(array))));
  });
}

/// Copies `array` to its place for `segment` in the array `kept`, or back.
void Segmenter::copy(Value array, Value kept, Value segment, bool restores) {
  auto type = cast<MemRefType>(array.getType());
  SmallVector<Value> lower, upper, step;
  for (auto [i, extent] : llvm::enumerate(type.getShape())) {
    lower.push_back(constant(0));
    upper.push_back(ShapedType::isDynamic(extent)
                        ? Value(memref::DimOp::create(b, array, i))
                        : constant(extent));
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
    Value scaled = multiply(number, constant(step));
    if (!type.isIndex())
      scaled = arith::IndexCastOp::create(b, type, scaled);
    return add(scaled, loop.getLowerBound());
  };
  Value lower = getBound(from), upper = getBound(to);
  auto made = cast<scf::ForOp>(b.clone(*loop));
  made.setLowerBound(lower);
  made.setUpperBound(upper);
  made.getInitArgsMutable().assign(inits);
  return made;
}

/// Replaces `loop` by one over segments, which runs the loops `earlier` for
/// each segment before it. All but the reverse loop record nothing when they
/// are replaced, and keep the numbers that they carry.
void Segmenter::makeLoop(scf::ForOp loop, ArrayRef<scf::ForOp> earlier,
                         bool isReverse) {
  b.setLoc(loop.getLoc());
  b.setInsertionPoint(loop);
  Value zero = constant(0), one = constant(1);
  auto made = scf::ForOp::create(b, zero, count, one, loop.getInitArgs());
  if (made.getNumResults() == 0)
    made.getBody()->getTerminator()->erase();
  b.setInsertionPointToEnd(made.getBody());
  Value segment = made.getInductionVar();
  if (isReverse)
    segment = b.createOrFold<arith::SubIOp>(
        b.createOrFold<arith::SubIOp>(count, one), segment);
  for (auto &[array, copies] : kept.arrays)
    copy(array, copies, segment, /*restores=*/!earlier.empty());
  Value first = multiply(segment, length);
  Value last = b.createOrFold<arith::MinSIOp>(add(first, length), trips);
  SmallVector<scf::ForOp> &parts = inner.emplace_back();
  for (scf::ForOp again : earlier) {
    SmallVector<Value> inits;
    for (Value numbers : kept.numbers[again])
      inits.push_back(memref::LoadOp::create(b, numbers, segment));
    scf::ForOp part = cloneRange(again, first, last, inits);
    shift(part, first);
    parts.push_back(part);
  }
  if (!isReverse)
    for (auto [value, numbers] :
         llvm::zip(made.getRegionIterArgs(), kept.numbers[loop]))
      memref::StoreOp::create(b, value, numbers, segment);
  Value from = first, to = last;
  if (isReverse) {
    from = b.createOrFold<arith::SubIOp>(trips, last);
    to = b.createOrFold<arith::SubIOp>(trips, first);
  }
  scf::ForOp part = cloneRange(loop, from, to, made.getRegionIterArgs());
  parts.push_back(part);
  if (!isReverse)
    part->walk([&](memref::StoreOp store) {
      if (found.records.contains(store.getMemref()))
        store.erase();
    });
  shift(part, first);
  scf::YieldOp::create(b, part.getResults());
  loop.replaceAllUsesWith(made.getResults());
}

/// Divides the loops into segments of `segmentLength` iterations.
void Segmenter::rewrite(Value segmentLength) {
  scf::ForOp forward = found.forward, reverse = found.reverse;
  b.setLoc(forward.getLoc());
  b.setInsertionPoint(forward);
  length = segmentLength;
  count = divideUp(trips, length);
  auto keep = [&](Type element, ArrayRef<int64_t> shape,
                  ValueRange sizes = {}) -> Value {
    std::optional<int64_t> known = getConstant(count);
    SmallVector<int64_t> extents{known.value_or(ShapedType::kDynamic)};
    llvm::append_range(extents, shape);
    SmallVector<Value> operands;
    if (!known)
      operands.push_back(count);
    llvm::append_range(operands, sizes);
    return memref::AllocOp::create(b, MemRefType::get(extents, element),
                                   operands);
  };
  for (Value array : found.state) {
    auto type = cast<MemRefType>(array.getType());
    SmallVector<Value> sizes;
    for (auto [i, extent] : llvm::enumerate(type.getShape()))
      if (ShapedType::isDynamic(extent))
        sizes.push_back(memref::DimOp::create(b, array, i));
    kept.arrays.emplace_back(
        array, keep(type.getElementType(), type.getShape(), sizes));
  }
  SmallVector<scf::ForOp> loops{forward};
  llvm::append_range(loops, found.replays);
  for (scf::ForOp loop : loops)
    for (Type type : loop.getResultTypes())
      kept.numbers[loop].push_back(keep(type, {}));
  for (auto &[array, positions] : found.records) {
    auto alloc = array.getDefiningOp<memref::AllocOp>();
    Value size = multiply(perIteration.lookup(array), length);
    if (std::optional<int64_t> known = getConstant(size)) {
      OpBuilder::InsertionGuard guard(b);
      b.setInsertionPoint(alloc);
      size = constant(*known);
    } else if (alloc->isBeforeInBlock(forward)) {
      alloc->moveBefore(forward);
    }
    alloc.getDynamicSizesMutable().assign(size);
  }
  for (auto [i, loop] : llvm::enumerate(loops))
    makeLoop(loop, ArrayRef(loops).take_front(i), /*isReverse=*/false);
  makeLoop(reverse, loops, /*isReverse=*/true);

  // Memory that a segment needs is freed after the last one.
  Operation *after = reverse;
  for (Value array : found.read)
    for (Operation *user : llvm::make_early_inc_range(array.getUsers()))
      if (isa<memref::DeallocOp>(user) && user->getBlock() == &body &&
          isAfter(user, forward) && user->isBeforeInBlock(reverse)) {
        user->moveAfter(after);
        after = user;
      }
  b.setInsertionPointAfter(after);
  for (auto &[array, copies] : kept.arrays)
    memref::DeallocOp::create(b, copies);
  for (scf::ForOp loop : loops)
    for (Value numbers : kept.numbers[loop])
      memref::DeallocOp::create(b, numbers);
  reverse.erase();
  for (scf::ForOp loop : llvm::reverse(loops))
    loop.erase();
}

/// Makes the body of a loop that runs once take its place.
static void promote(scf::ForOp loop) {
  IRRewriter rewriter(loop.getContext());
  SmallVector<Value> values{loop.getLowerBound()};
  llvm::append_range(values, loop.getInitArgs());
  auto yield = cast<scf::YieldOp>(loop.getBody()->getTerminator());
  SmallVector<Value> results(yield.getOperands());
  for (Value &result : results)
    if (auto argument = dyn_cast<BlockArgument>(result);
        argument && argument.getOwner() == loop.getBody())
      result = values[argument.getArgNumber()];
  rewriter.eraseOp(yield);
  rewriter.inlineBlockBefore(loop.getBody(), loop, values);
  rewriter.replaceOp(loop, results);
}

/// Divides the loops into segments of one iteration, and then the loops in this
/// iteration, whose records may take `limit` bytes.
LogicalResult Segmenter::divideInner(int64_t limit) {
  if (limit <= 0)
    return failure();
  rewrite(constant(1));
  SmallVector<scf::ForOp> parts = inner.back();
  Block &block = *parts.front()->getBlock();
  for (scf::ForOp part : parts)
    promote(part);
  SmallVector<Value> records;
  for (auto &[array, positions] : found.records)
    records.push_back(array);
  return Segmenter(block, records, records, name).run(limit);
}

/// Divides loops whose numbers of iterations and records are constants.
LogicalResult Segmenter::runKnown(int64_t limit) {
  int64_t fixed = 0, perSegment = 0, recorded = 0;
  b.setInsertionPoint(found.forward);
  for (auto &[array, positions] : found.records) {
    recorded += *positions * getRowBytes(array);
    perIteration[array] = constant(*positions);
  }
  for (Value array : found.state) {
    auto type = cast<MemRefType>(array.getType());
    if (!type.hasStaticShape())
      return failure();
    perSegment += type.getNumElements() * getBytes(type.getElementType());
  }
  SmallVector<scf::ForOp> loops{found.forward};
  llvm::append_range(loops, found.replays);
  for (scf::ForOp loop : loops)
    for (Type type : loop.getResultTypes())
      perSegment += getBytes(type);
  for (Value array : all) {
    if (found.records.contains(array))
      continue;
    auto alloc = array.getDefiningOp<memref::AllocOp>();
    std::optional<uint64_t> bytes =
        alloc ? getAllocatedBytes(alloc) : std::nullopt;
    if (!bytes)
      return failure();
    fixed += *bytes;
  }
  trips = constant(*found.trips);
  // The longest segments that fit: the fewest copies.
  for (int64_t length = *found.trips - 1; length > 0; --length) {
    int64_t segments = llvm::divideCeil(*found.trips, length);
    if (fixed + segments * perSegment + length * recorded > limit)
      continue;
    rewrite(constant(length));
    return success();
  }
  return divideInner(limit - fixed - *found.trips * perSegment);
}

/// Divides loops whose numbers of iterations or records are known at run time.
/// The length of segments is computed there, and an assertion fails if even the
/// shortest take too much memory.
LogicalResult Segmenter::runUnknown(int64_t limit) {
  scf::ForOp forward = found.forward;
  if (forward.getUnsignedCmp() || found.reverse.getUnsignedCmp() ||
      !isBeforeLoops(forward.getUpperBound()))
    return failure();
  std::optional<int64_t> step = getConstant(forward.getStep());
  if (!step || *step <= 0)
    return failure();
  for (scf::ForOp replay : found.replays)
    if (getConstant(replay.getStep()) != step)
      return failure();
  b.setLoc(forward.getLoc());
  b.setInsertionPoint(forward);
  Value one = constant(1);
  Value lower = toIndex(forward.getLowerBound());
  Value upper = toIndex(forward.getUpperBound());
  trips = divideUp(b.createOrFold<arith::SubIOp>(
                       b.createOrFold<arith::MaxSIOp>(lower, upper), lower),
                   constant(*step));
  Value nonZero = b.createOrFold<arith::MaxSIOp>(trips, one);
  TraceBytes fixed, perSegment, recorded;
  for (auto &[array, positions] : found.records) {
    auto alloc = array.getDefiningOp<memref::AllocOp>();
    Value count;
    if (positions)
      count = constant(*positions);
    else if (isBeforeLoops(array) && alloc->getBlock() == &body)
      count =
          b.createOrFold<arith::DivUIOp>(alloc.getDynamicSizes()[0], nonZero);
    else // A replay records one value for each iteration.
      count = one;
    perIteration[array] = count;
    recorded.values.push_back(multiply(count, constant(getRowBytes(array))));
  }
  for (Value array : found.state)
    if (!array.getDefiningOp<memref::AllocOp>() || !addBytes(array, perSegment))
      return failure();
  SmallVector<scf::ForOp> loops{forward};
  llvm::append_range(loops, found.replays);
  for (scf::ForOp loop : loops)
    for (Type type : loop.getResultTypes())
      perSegment.known += getBytes(type);
  for (Value array : all)
    if (!found.records.contains(array) &&
        (!array.getDefiningOp<memref::AllocOp>() || !addBytes(array, fixed)))
      return failure();
  Value available =
      b.createOrFold<arith::SubIOp>(constant(limit), fixed.sum(b));
  Value bySegment = perSegment.sum(b), byIteration = recorded.sum(b);
  auto isExceeded = [&](Value segmentLength) -> Value {
    Value segments = divideUp(trips, segmentLength);
    Value bytes = add(multiply(segments, bySegment),
                      multiply(segmentLength, byIteration));
    return arith::CmpIOp::create(b, arith::CmpIPredicate::sgt, bytes,
                                 available);
  };
  // The longest segments that fit: the fewest copies.
  auto search = scf::WhileOp::create(
      b, TypeRange{b.getIndexType()}, ValueRange{nonZero},
      [&](OpBuilder &nested, Location loc, ValueRange arguments) {
        OpBuilder::InsertionGuard guard(b);
        b.setInsertionPointToEnd(nested.getInsertionBlock());
        Value exceeds = isExceeded(arguments[0]);
        Value isLonger = arith::CmpIOp::create(b, arith::CmpIPredicate::sgt,
                                               arguments[0], one);
        Value goesOn = arith::AndIOp::create(b, exceeds, isLonger);
        scf::ConditionOp::create(b, goesOn, arguments);
      },
      [&](OpBuilder &nested, Location loc, ValueRange arguments) {
        OpBuilder::InsertionGuard guard(b);
        b.setInsertionPointToEnd(nested.getInsertionBlock());
        Value shorter = arith::SubIOp::create(b, arguments[0], one);
        scf::YieldOp::create(b, shorter);
      });
  b.setInsertionPoint(forward);
  Value fits =
      arith::XOrIOp::create(b, isExceeded(search.getResult(0)),
                            arith::ConstantOp::create(b, b.getBoolAttr(true)));
  assertBytes(b, fits, name, limit);
  rewrite(search.getResult(0));
  return success();
}

LogicalResult Segmenter::run(int64_t limit) {
  if (!findLoops() || !findState())
    return failure();
  bool isKnown =
      found.trips && llvm::all_of(found.records, [](const auto &entry) {
        return entry.second.has_value();
      });
  return isKnown ? runKnown(limit) : runUnknown(limit);
}

LogicalResult tai::divideTraces(FunctionOpInterface gradient, StringRef name,
                                ArrayRef<Value> records, ArrayRef<Value> arrays,
                                uint64_t limit) {
  Block &body = gradient.getFunctionBody().front();
  if (succeeded(Segmenter(body, records, arrays, name).run(limit)))
    return success();
  return assertTraces(body, name, arrays, limit);
}
