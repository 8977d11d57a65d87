//===- Traces.cpp - Values that a function read ---------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Foreign/Traces.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/IR/Matchers.h"
#include "tai/AD/Foreign/Foreign.h"
#include "llvm/ADT/MapVector.h"
#include "llvm/ADT/SetVector.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// Describes how the executions of one block are numbered. The number of an
/// execution is the position of a recorded value in its trace.
struct Slot {
  /// A value of the primal: the number of the present execution of the block.
  Value number;
  /// A value of the primal, before the first loop: the number of all executions
  /// of the block, or null if it cannot be computed before the loop.
  Value count;
  /// A value of the gradient: the memref that holds the number of the block's
  /// next execution.
  Value next;
};

/// A recorded value: the result of a read, or the number at which a loop
/// begins.
struct Recorded {
  /// The value of the primal that is recorded; null for the number at which a
  /// loop begins.
  Value value;
  /// The op of the primal that loads the recorded value from the trace.
  memref::LoadOp fromTrace;
  Block *block;
  /// If the recorded value is the number at which a loop begins: the block
  /// whose executions are numbered.
  Block *begins = nullptr;
};

class Recorder {
public:
  Recorder(FunctionOpInterface primal, FunctionOpInterface gradient,
           TraceMode mode)
      : primal(primal), gradient(gradient), mode(mode),
        b(primal.getLoc(), primal.getContext()) {}

  Traces run(ArrayRef<Operation *> reads);

private:
  void serializeLoops(Operation *read);
  void countIterations(scf::WhileOp loop);
  Value getIteration(Operation *loop, Block *block);
  SmallVector<Value> getTripCounts(Operation *loop);
  bool isKnownOutside(Operation *loop, Operation *outer);
  Slot &getSlot(Block *block);
  memref::LoadOp readTrace(Type type, Value number);
  Value toIndex(Value value) {
    return value.getType().isIndex()
               ? value
               : b.createOrFold<arith::IndexCastOp>(b.getIndexType(), value);
  }

  void rerun();
  void record(Recorded &what, Traces &traces);
  void prune();
  Value ensureRoom(Value cell, Value number);

  FunctionOpInterface primal, gradient;
  TraceMode mode;
  ImplicitLocOpBuilder b;
  llvm::MapVector<Block *, Slot> slots;
  SmallVector<Recorded> all;
  /// Maps values of the primal to the values of the second execution, in the
  /// gradient.
  IRMapping again;
  SmallVector<std::pair<unsigned, Value>> copies;
  SmallVector<Value> toFree;
  DenseSet<Operation *> counted;
  Operation *end = nullptr;
};
} // namespace

/// The loops around a block, from the outermost to the innermost, each with the
/// block of the loop that contains `block`.
static SmallVector<std::pair<Operation *, Block *>> getLoops(Block *block) {
  SmallVector<std::pair<Operation *, Block *>> loops;
  while (!isa<FunctionOpInterface>(block->getParentOp())) {
    Operation *op = block->getParentOp();
    if (isa<scf::ForOp, scf::ParallelOp, scf::WhileOp>(op))
      loops.emplace_back(op, block);
    block = op->getBlock();
  }
  std::reverse(loops.begin(), loops.end());
  return loops;
}

/// Returns the block of the innermost loop around `op`, or of the function.
static Block *getLoopBlock(Operation *op) {
  Block *block = op->getBlock();
  while (!isa<FunctionOpInterface, scf::ForOp, scf::ParallelOp, scf::WhileOp>(
      block->getParentOp()))
    block = block->getParentOp()->getBlock();
  return block;
}

/// True if the bounds of `loop` are computed outside of `outer`.
bool Recorder::isKnownOutside(Operation *loop, Operation *outer) {
  if (isa<scf::WhileOp>(loop))
    return false;
  size_t count = loop->getNumOperands();
  if (auto forOp = dyn_cast<scf::ForOp>(loop))
    count = 3;
  else
    count = 3 * cast<scf::ParallelOp>(loop).getNumLoops();
  return llvm::all_of(loop->getOperands().take_front(count), [&](Value value) {
    return !outer->isAncestor(value.getParentBlock()->getParentOp());
  });
}

/// True if the bounds of `loop` are computed in the body of the function,
/// before its outermost op that contains `loop`.
static bool isKnownInFunction(Operation *loop, FunctionOpInterface function) {
  if (isa<scf::WhileOp>(loop))
    return false;
  Block *body = &function.getFunctionBody().front();
  Operation *outermost = body->findAncestorOpInBlock(*loop);
  size_t count =
      isa<scf::ForOp>(loop) ? 3 : 3 * cast<scf::ParallelOp>(loop).getNumLoops();
  return llvm::all_of(loop->getOperands().take_front(count), [&](Value value) {
    return value.getParentBlock() == body &&
           (!value.getDefiningOp() ||
            value.getDefiningOp()->isBeforeInBlock(outermost));
  });
}

/// Makes the parallel loops around `read` serial, unless all trip counts are
/// computed before the first loop: executions are then numbered as they happen.
void Recorder::serializeLoops(Operation *read) {
  SmallVector<scf::ParallelOp> parallel;
  bool isKnown = true;
  for (auto [loop, block] : getLoops(read->getBlock())) {
    isKnown &= isKnownInFunction(loop, primal);
    if (auto op = dyn_cast<scf::ParallelOp>(loop))
      parallel.push_back(op);
  }
  if (isKnown)
    return;
  for (scf::ParallelOp loop : llvm::reverse(parallel))
    serialize(loop);
}

/// Makes an scf.while carry the number of the current iteration.
void Recorder::countIterations(scf::WhileOp loop) {
  if (counted.contains(loop))
    return;
  b.setInsertionPoint(loop);
  b.setLoc(loop.getLoc());
  SmallVector<Value> inits(loop.getInits());
  inits.push_back(arith::ConstantIndexOp::create(b, 0));
  SmallVector<Type> types(loop.getResultTypes());
  types.push_back(b.getIndexType());
  auto made = scf::WhileOp::create(b, types, inits);
  made.getBefore().takeBody(loop.getBefore());
  made.getAfter().takeBody(loop.getAfter());
  Value before =
      made.getBeforeBody()->addArgument(b.getIndexType(), b.getLoc());
  Value after = made.getAfterBody()->addArgument(b.getIndexType(), b.getLoc());
  made.getConditionOp().getArgsMutable().append(before);
  scf::YieldOp yield = made.getYieldOp();
  b.setInsertionPoint(yield);
  Value next =
      arith::AddIOp::create(b, after, arith::ConstantIndexOp::create(b, 1));
  yield.getResultsMutable().append(next);
  loop.replaceAllUsesWith(made.getResults().drop_back());
  loop.erase();
  counted.insert(made);
}

/// The trip count of a loop along each of its dimensions.
SmallVector<Value> Recorder::getTripCounts(Operation *loop) {
  auto count = [&](Value lower, Value upper, Value step) -> Value {
    lower = toIndex(lower);
    upper = b.createOrFold<arith::MaxSIOp>(toIndex(upper), lower);
    Value distance = b.createOrFold<arith::SubIOp>(upper, lower);
    return b.createOrFold<arith::CeilDivUIOp>(distance, toIndex(step));
  };
  if (auto forOp = dyn_cast<scf::ForOp>(loop))
    return {
        count(forOp.getLowerBound(), forOp.getUpperBound(), forOp.getStep())};
  auto parallel = cast<scf::ParallelOp>(loop);
  SmallVector<Value> counts;
  for (auto [lower, upper, step] :
       llvm::zip(parallel.getLowerBound(), parallel.getUpperBound(),
                 parallel.getStep()))
    counts.push_back(count(lower, upper, step));
  return counts;
}

/// The number of the current iteration of `loop`, linearized over the
/// dimensions of the loop. `block` is the block of the loop that contains the
/// insertion point.
Value Recorder::getIteration(Operation *loop, Block *block) {
  if (isa<scf::WhileOp>(loop))
    return block->getArguments().back();
  auto number = [&](Value iv, Value lower, Value step) -> Value {
    Value distance = b.createOrFold<arith::SubIOp>(toIndex(iv), toIndex(lower));
    return b.createOrFold<arith::DivUIOp>(distance, toIndex(step));
  };
  if (auto forOp = dyn_cast<scf::ForOp>(loop))
    return number(forOp.getInductionVar(), forOp.getLowerBound(),
                  forOp.getStep());
  auto parallel = cast<scf::ParallelOp>(loop);
  Value all;
  for (auto [iv, lower, step, count] :
       llvm::zip(parallel.getInductionVars(), parallel.getLowerBound(),
                 parallel.getStep(), getTripCounts(loop))) {
    Value one = number(iv, lower, step);
    all = all ? b.createOrFold<arith::AddIOp>(
                    b.createOrFold<arith::MulIOp>(all, count), one)
              : one;
  }
  return all;
}

memref::LoadOp Recorder::readTrace(Type type, Value number) {
  Block &body = primal.getFunctionBody().front();
  Value array = body.addArgument(MemRefType::get({ShapedType::kDynamic}, type),
                                 primal.getLoc());
  return memref::LoadOp::create(b, array, number);
}

/// Returns how the executions of `block` are numbered; makes the numbering if
/// there is none yet. `block` is the body of a loop or of the function.
Slot &Recorder::getSlot(Block *block) {
  if (auto *it = slots.find(block); it != slots.end())
    return it->second;
  OpBuilder::InsertionGuard guard(b);
  SmallVector<std::pair<Operation *, Block *>> loops = getLoops(block);
  Slot slot;
  bool isKnown = llvm::all_of(loops, [&](auto entry) {
    return isKnownInFunction(entry.first, primal);
  });
  size_t first = 0;
  Value base;
  if (!isKnown) {
    // Finds the longest nest of loops down to `block` whose trip counts, but
    // for that of its first loop, are computed before its first loop.
    first = loops.size() - 1;
    auto extendsTo = [&](size_t begin) {
      return llvm::all_of(
          llvm::drop_begin(loops, begin + 1), [&](const auto &entry) {
            return isKnownOutside(entry.first, loops[begin].first);
          });
    };
    while (first > 0 && extendsTo(first - 1))
      --first;
    if (first > 0) {
      // In each execution, a nest of loops continues the numbering of its
      // block: the number at which the nest begins is recorded in a trace of
      // its own.
      Operation *begin = loops[first].first;
      Slot outer = getSlot(getLoopBlock(begin));
      b.setInsertionPoint(begin);
      memref::LoadOp read = readTrace(b.getIndexType(), outer.number);
      all.push_back({Value(), read, getLoopBlock(begin), block});
      base = read;
    }
  }
  Operation *outermost =
      loops.empty() ? nullptr
                    : primal.getFunctionBody().front().findAncestorOpInBlock(
                          *loops.front().first);
  SmallVector<Value> sizes;
  for (auto [i, entry] : llvm::enumerate(loops)) {
    Value size;
    if (i >= first && (isKnown || i > first)) {
      b.setInsertionPoint(isKnown ? outermost : loops[first].first);
      for (Value count : getTripCounts(entry.first))
        size = size ? b.createOrFold<arith::MulIOp>(size, count) : count;
    }
    sizes.push_back(size);
  }
  if (isKnown) {
    Value count;
    if (outermost)
      b.setInsertionPoint(outermost);
    else
      b.setInsertionPointToStart(block);
    for (Value size : sizes)
      count = count ? b.createOrFold<arith::MulIOp>(count, size) : size;
    slot.count = count ? count : Value(arith::ConstantIndexOp::create(b, 1));
  }
  b.setInsertionPointToStart(block);
  Value number;
  for (size_t i = first; i < loops.size(); ++i) {
    // Emits the iteration numbers of all loops around at the start of `block`.
    Value one = getIteration(loops[i].first, loops[i].second);
    number = number ? b.createOrFold<arith::AddIOp>(
                          b.createOrFold<arith::MulIOp>(number, sizes[i]), one)
                    : one;
  }
  if (!number)
    number = arith::ConstantIndexOp::create(b, 0);
  if (base)
    number = b.createOrFold<arith::AddIOp>(base, number);
  slot.number = number;
  return slots.insert({block, slot}).first->second;
}

//===----------------------------------------------------------------------===//
// The second execution
//===----------------------------------------------------------------------===//

/// Repeats the primal at the start of the gradient: the second execution, whose
/// values are recorded. In mode Rerun, it writes to copies of the arrays.
void Recorder::rerun() {
  Block &body = primal.getFunctionBody().front();
  Block &target = gradient.getFunctionBody().front();
  b.setInsertionPointToStart(&target);
  // This constant marks the end of the second execution; the reverse sweep will
  // follow it.
  end = arith::ConstantIndexOp::create(b, 0);
  b.setInsertionPoint(end);
  for (unsigned i = 0, e = primal.getNumArguments(); i != e; ++i) {
    Value from = body.getArgument(i), to = target.getArgument(i);
    auto type = dyn_cast<MemRefType>(from.getType());
    bool isWritten = type && llvm::any_of(from.getUsers(), [&](Operation *op) {
                       return isa<memref::AtomicRMWOp>(op) ||
                              (isa<memref::StoreOp>(op) &&
                               cast<memref::StoreOp>(op).getMemref() == from);
                     });
    Value array = to;
    if (isWritten && mode == TraceMode::Rerun) {
      SmallVector<Value> sizes;
      for (int64_t i = 0; i != type.getRank(); ++i)
        if (type.isDynamicDim(i))
          sizes.push_back(memref::DimOp::create(b, to, i));
      array = memref::AllocOp::create(
          b,
          MemRefType::get(type.getShape(), type.getElementType(),
                          MemRefLayoutAttrInterface(), type.getMemorySpace()),
          sizes);
      memref::CopyOp::create(b, to, array);
      copies.emplace_back(i, array);
    }
    again.map(from, array);
  }
  for (Operation &op : body.without_terminator())
    b.clone(op, again);
  for (auto &[position, array] : copies)
    memref::DeallocOp::create(b, array);
  if (mode == TraceMode::Augmented) {
    b.setInsertionPointAfter(end);
    b.clone(*body.getTerminator(), again);
  }
}

/// Loads the array of a trace from `cell`; grows the array if it has no element
/// `number`.
Value Recorder::ensureRoom(Value cell, Value number) {
  Value array = memref::LoadOp::create(b, cell, ValueRange());
  Value zero = arith::ConstantIndexOp::create(b, 0);
  Value room = memref::DimOp::create(b, array, zero);
  Value isFull =
      arith::CmpIOp::create(b, arith::CmpIPredicate::sge, number, room);
  auto grown = scf::IfOp::create(
      b, isFull,
      [&](OpBuilder &nested, Location loc) {
        ImplicitLocOpBuilder n(loc, nested);
        Value two = arith::ConstantIndexOp::create(n, 2);
        Value one = arith::ConstantIndexOp::create(n, 1);
        Value wanted = arith::MulIOp::create(
            n, arith::AddIOp::create(n, number, one), two);
        Value larger = memref::AllocOp::create(
            n, cast<MemRefType>(array.getType()), wanted);
        scf::ForOp::create(
            n, zero, room, one, ValueRange(),
            [&](OpBuilder &inner, Location at, Value i, ValueRange) {
              Value old = memref::LoadOp::create(inner, at, array, i);
              memref::StoreOp::create(inner, at, old, larger, i);
              scf::YieldOp::create(inner, at);
            });
        memref::DeallocOp::create(n, array);
        memref::StoreOp::create(n, larger, cell, ValueRange());
        scf::YieldOp::create(n, larger);
      },
      [&](OpBuilder &nested, Location loc) {
        scf::YieldOp::create(nested, loc, array);
      });
  return grown.getResult(0);
}

/// Makes the second execution store the value `what` in a trace, and adds the
/// trace to `traces`.
void Recorder::record(Recorded &what, Traces &traces) {
  Slot &slot = slots[what.block];
  Value number = again.lookup(slot.number);
  auto type = cast<MemRefType>(what.fromTrace.getMemref().getType());
  Value value;
  if (what.value) {
    value = again.lookup(what.value);
    b.setInsertionPointAfterValue(value);
  } else {
    // For a nest of loops, the number at which it begins is recorded, which is
    // the number at which its previous execution has ended.
    Operation *copy = again.lookup(what.fromTrace.getResult()).getDefiningOp();
    b.setInsertionPoint(copy);
    value = memref::LoadOp::create(b, slots[what.begins].next, ValueRange());
    copy->replaceAllUsesWith(ValueRange{value});
    copy->erase();
    b.setInsertionPointAfterValue(value);
    again.map(what.fromTrace.getResult(), value);
    if (number.getDefiningOp() == copy)
      number = value;
  }
  if (slot.count) {
    Value array;
    {
      OpBuilder::InsertionGuard guard(b);
      Value count = again.lookup(slot.count);
      b.setInsertionPointAfterValue(count);
      array = memref::AllocOp::create(b, type, count);
    }
    memref::StoreOp::create(b, value, array, number);
    traces.arrays.emplace_back(what.fromTrace.getMemref(), array);
    return;
  }
  Value cell;
  {
    OpBuilder::InsertionGuard guard(b);
    b.setInsertionPointToStart(&gradient.getFunctionBody().front());
    cell = memref::AllocaOp::create(b, MemRefType::get({}, type));
    Value room = arith::ConstantIndexOp::create(b, 64);
    Value array = memref::AllocOp::create(b, type, room);
    memref::StoreOp::create(b, array, cell, ValueRange());
  }
  Value array = ensureRoom(cell, number);
  memref::StoreOp::create(b, value, array, number);
  if (slot.next) {
    Value one = arith::ConstantIndexOp::create(b, 1);
    memref::StoreOp::create(b, arith::AddIOp::create(b, number, one), slot.next,
                            ValueRange());
  }
  b.setInsertionPointAfter(end);
  traces.arrays.emplace_back(what.fromTrace.getMemref(),
                             memref::LoadOp::create(b, cell, ValueRange()));
}

/// Drops arrays that the second execution stores to and never reads.
void Recorder::prune() {
  auto isOnlyWritten = [](Value array) {
    return llvm::all_of(array.getUsers(), [&](Operation *op) {
      if (auto store = dyn_cast<memref::StoreOp>(op))
        return store.getMemref() == array && store.getValueToStore() != array;
      if (auto copy = dyn_cast<memref::CopyOp>(op))
        return copy.getSource() != array;
      if (auto atomic = dyn_cast<memref::AtomicRMWOp>(op))
        return atomic.use_empty();
      return isa<memref::DeallocOp>(op);
    });
  };
  bool changed = true;
  while (changed) {
    changed = false;
    SmallVector<Operation *> dead;
    for (Operation &op : gradient.getFunctionBody().front()) {
      if (&op == end)
        break;
      op.walk([&](Operation *inner) {
        if (isa<memref::AllocOp, memref::AllocaOp>(inner) &&
            isOnlyWritten(inner->getResult(0)) &&
            llvm::none_of(toFree, [&](Value kept) {
              return kept == inner->getResult(0);
            }))
          dead.push_back(inner);
      });
    }
    for (Operation *op : dead) {
      for (Operation *user :
           llvm::make_early_inc_range(op->getResult(0).getUsers()))
        user->erase();
      llvm::erase_if(copies, [&](auto &entry) {
        return entry.second == op->getResult(0);
      });
      op->erase();
      changed = true;
    }
    // Ops of the second execution that have become dead are erased, because
    // their users were erased.
    SmallVector<Operation *> ops;
    for (Operation &op : gradient.getFunctionBody().front()) {
      if (&op == end)
        break;
      op.walk<WalkOrder::PreOrder>(
          [&](Operation *inner) { ops.push_back(inner); });
    }
    // Ops are visited in reverse, so that inner ops come before the ops around
    // them, and users before the ops that make their operands.
    for (Operation *op : llvm::reverse(ops))
      if (isOpTriviallyDead(op)) {
        op->erase();
        changed = true;
      }
  }
}

Traces Recorder::run(ArrayRef<Operation *> reads) {
  for (Operation *read : reads)
    serializeLoops(read);
  for (Operation *read : reads)
    for (auto [loop, block] : getLoops(read->getBlock()))
      if (auto whileOp = dyn_cast<scf::WhileOp>(loop))
        countIterations(whileOp);
  Traces traces;
  for (Operation *read : reads) {
    Value value = read->getResult(0);
    Slot slot = getSlot(getLoopBlock(read));
    b.setInsertionPoint(read);
    memref::LoadOp fromTrace = readTrace(value.getType(), slot.number);
    all.push_back({value, fromTrace, getLoopBlock(read)});
    traces.recorded[value] = fromTrace;
  }
  rerun();
  // `next` starts at zero. Each nest of loops begins at the number that its
  // previous execution has left there.
  b.setInsertionPointToStart(&gradient.getFunctionBody().front());
  for (Recorded &what : all)
    if (what.begins) {
      Slot &slot = slots[what.begins];
      b.setInsertionPointToStart(&gradient.getFunctionBody().front());
      slot.next =
          memref::AllocaOp::create(b, MemRefType::get({}, b.getIndexType()));
      memref::StoreOp::create(b, arith::ConstantIndexOp::create(b, 0),
                              slot.next, ValueRange());
    }
  for (Recorded &what : all)
    record(what, traces);
  for (Recorded &what : all)
    if (what.value)
      if (Operation *copy =
              again.lookup(what.fromTrace.getResult()).getDefiningOp())
        copy->erase();
  if (mode == TraceMode::Augmented) {
    Operation *exit = gradient.getFunctionBody().front().getTerminator();
    for (auto &[from, array] : traces.arrays)
      exit->insertOperands(exit->getNumOperands(), array);
  }
  for (auto &[from, array] : traces.arrays)
    toFree.push_back(array);
  prune();
  for (auto &[position, array] : copies)
    if (llvm::any_of(array.getUsers(), [](Operation *op) {
          return !isa<memref::StoreOp, memref::DeallocOp, memref::CopyOp>(op);
        }))
      traces.before.push_back(position);
  return traces;
}

Traces mlir::tai::recordReads(FunctionOpInterface primal,
                              FunctionOpInterface gradient,
                              ArrayRef<Operation *> reads, TraceMode mode) {
  return Recorder(primal, gradient, mode).run(reads);
}
