//===- CoarsenThreads.cpp - Thread coarsening on GPUs ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// With one element of a large array in each thread, a GPU spends more on
// computing the address of the element, and whether it is at a border, than on
// the memory access. Here each iteration gets a strip of neighbours along the
// innermost index, usually 16 bytes:
//
//   parallel for (i, j) { body(i, j) }
//
// becomes
//
//   parallel for (tileRow, tileColumn, row, strip) {
//     i = 8 * tileRow + row;  j = 4 * (32 * tileColumn + strip);
//     if (inside(i, j))  { body'(i, j), …, body'(i, j + 3) }
//     else  for (k = j; k < j + 4; ++k)  body(i, k)
//   }
//
// In body' all conditions on single indices (is this a border, does an index
// wrap) are constants, and the operations of the four elements are interleaved,
// so that loads and stores of neighbours are combined. A value that several of
// the four read is loaded once. The iterations of a block cover a tile, whose
// rows share their neighbours in the L1 cache.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/Index/IndexShift.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Analysis/Reductions/Accumulation.h"
#include "tai/Dialect/Tai/IR/Modes.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Utils/FieldAddress.h"
#include "tai/Transforms/Utils/IndexMath.h"
#include "tai/Transforms/Utils/SumOrder.h"
#include "llvm/ADT/TypeSwitch.h"

namespace mlir::tai {
#define GEN_PASS_DEF_COARSENTHREADS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// The number of bytes that a thread reads and writes by one vector access.
constexpr int64_t kVectorBytes = 16;
/// The number of iterations of a tile, which one or several blocks run.
constexpr int64_t kTileSize = 256;
constexpr int64_t kWidestTile = 32, kNarrowestTile = 8;
/// The most loads in an iteration: more values in flight would take the
/// registers of other threads.
constexpr int64_t kMaxLoads = 16;

namespace {
/// Describes how a loop is cut into strips, each of which one thread runs.
struct Strips {
  LoopBox box;
  /// width: the number of elements in a strip. first: the index of the first
  /// element of the first strip.
  int64_t width = 0, first = 0;
  /// The number of strips (columns of iterations) and of rows in a tile of
  /// iterations; 0 if there are no tiles.
  int64_t tileStrips = 0, tileRows = 0;
  /// The interior of the loop, as bounds of each index. In the interior, each
  /// condition of `answers` has the given value, and the two values of each
  /// pair of `same` are equal.
  SmallVector<int64_t> lower, upper;
  SmallVector<std::pair<Value, bool>> answers;
  SmallVector<std::pair<Value, Value>> same;

  int64_t getNumStrips() const {
    return llvm::divideCeil(box.upper.back() - first, width);
  }
  unsigned getRank() const { return box.lower.size(); }
};
} // namespace

//===----------------------------------------------------------------------===//
// Loops that can be cut, and their gain
//===----------------------------------------------------------------------===//

/// True for loops of loads, stores, arithmetic and branches: their iterations
/// can run in any order, and so also interleaved op by op.
static bool isSimple(ParallelForOp loop, int64_t maxOps) {
  int64_t ops = 0, loads = 0;
  WalkResult result = loop.getBody().walk([&](Operation *op) {
    if (++ops > maxOps)
      return WalkResult::interrupt();
    if (isa<LoadOp>(op))
      return ++loads > kMaxLoads ? WalkResult::interrupt()
                                 : WalkResult::advance();
    if (isa<StoreOp, scf::IfOp, scf::YieldOp, YieldOp>(op))
      return WalkResult::advance();
    if (auto atomic = dyn_cast<AtomicOp>(op)) {
      return atomic.getOld().use_empty() &&
                     (atomic.getExclusive() || isKeptInRegister(op))
                 ? WalkResult::advance()
                 : WalkResult::interrupt();
    }
    bool isArithmetic = isPure(op) && op->getNumRegions() == 0;
    return isArithmetic ? WalkResult::advance() : WalkResult::interrupt();
  });
  return !result.wasInterrupted();
}

static ValueRange getIndices(Operation *access) {
  return llvm::TypeSwitch<Operation *, ValueRange>(access)
      .Case<LoadOp, StoreOp, AtomicOp>([](auto op) { return op.getIndices(); })
      .Default([](Operation *) { return ValueRange(); });
}

/// Returns the loop index that an integer expression depends on, if it depends
/// on only one.
static std::optional<unsigned> getVariable(LoopBox &box, Value value) {
  SmallVector<Value> variables;
  if (matchPattern(value, m_Constant()) ||
      !collectIndexVariables(value, box.loop.getBody(), variables) ||
      variables.size() != 1)
    return std::nullopt;
  return box.find(variables.front());
}

/// Narrows the interior of the loop to the range in which `condition` is
/// constant, and returns its value there. Nullopt if large parts of the loop
/// would remain, in which the condition is evaluated as well.
static std::optional<bool> narrow(Strips &strips, Value condition, unsigned k) {
  LoopBox &box = strips.box;
  std::optional<ConstantStretch> stretch = getConstantStretch(
      condition, box.ivs()[k], strips.lower[k], strips.upper[k]);
  int64_t length = box.upper[k] - box.lower[k];
  if (!stretch || stretch->upper - stretch->lower < length - length / 8)
    return std::nullopt;
  strips.lower[k] = stretch->lower;
  strips.upper[k] = stretch->upper;
  return stretch->answer;
}

/// The operand that a minimum or maximum of indices equals in the interior of
/// the loop, where conditions at the border do not apply; null if there is
/// none.
static Value chooseExtreme(Strips &strips, Operation *op, unsigned k) {
  bool isMin = isa<arith::MinSIOp>(op);
  OpBuilder builder(op);
  // This op is temporary, and serves the analysis alone.
  auto isFirst = arith::CmpIOp::create(builder, op->getLoc(),
                                       isMin ? arith::CmpIPredicate::sle
                                             : arith::CmpIPredicate::sge,
                                       op->getOperand(0), op->getOperand(1));
  std::optional<bool> answer = narrow(strips, isFirst, k);
  isFirst.erase();
  return answer ? op->getOperand(*answer ? 0 : 1) : Value();
}

/// Finds the interior of the loop, and the conditions and extrema that are
/// constant in it.
static void findInterior(Strips &strips) {
  LoopBox &box = strips.box;
  strips.lower = box.lower;
  strips.upper = box.upper;
  SmallVector<std::pair<Value, unsigned>> questions;
  box.loop.getBody().walk([&](Operation *op) {
    bool isExtreme = isa<arith::MinSIOp, arith::MaxSIOp>(op);
    for (Value result : op->getResults())
      if (isExtreme || result.getType().isInteger(1))
        if (std::optional<unsigned> k = getVariable(box, result))
          questions.push_back({result, *k});
  });
  for (auto [value, k] : questions) {
    if (!value.getType().isInteger(1)) {
      if (Value chosen = chooseExtreme(strips, value.getDefiningOp(), k))
        strips.same.push_back({value, chosen});
    } else if (std::optional<bool> answer = narrow(strips, value, k)) {
      strips.answers.push_back({value, *answer});
    }
  }
}

/// The distance, in bytes, of the elements that two consecutive iterations of
/// the interior access. Nullopt if they are far apart. `origin` gets the first
/// index of the dimension.
static std::optional<int64_t> getStride(Operation *access, Strips &strips,
                                        const FieldInfo &field,
                                        int64_t &origin) {
  LoopBox &box = strips.box;
  Value iv = box.ivs().back();
  std::optional<unsigned> found;
  for (auto [dimension, index] : llvm::enumerate(getIndices(access))) {
    SmallVector<Value> variables;
    if (!collectIndexVariables(index, box.loop.getBody(), variables))
      return std::nullopt;
    if (!llvm::is_contained(variables, iv))
      continue;
    if (found || variables.size() > 1 ||
        !getIndexShift(index, iv, strips.lower.back(), strips.upper.back()))
      return std::nullopt;
    found = dimension;
  }
  if (!found)
    return std::nullopt;
  std::optional<int64_t> stride;
  for (const IndexDigit &digit : field.storage.digits) {
    if (digit.dimension != *found || digit.extent == 1)
      continue;
    if (stride || !digit.isWhole)
      return std::nullopt;
    stride = digit.stride;
  }
  origin = field.layout.offset[*found];
  return stride && *stride < kVectorBytes ? stride : std::nullopt;
}

/// Chooses the number of elements in a strip. False if consecutive iterations
/// do not access adjacent elements.
static bool chooseWidth(Strips &strips, FieldTable &fields) {
  LoopBox &box = strips.box;
  int64_t together = 0, apart = 0, smallest = kVectorBytes, origin = 0;
  WalkResult result = box.loop.getBody().walk([&](Operation *op) {
    if (!isa<LoadOp, StoreOp, AtomicOp>(op))
      return WalkResult::advance();
    auto field = fields.lookup(op, getNamedField(op));
    if (failed(field) || !(*field)->sparse.empty())
      return WalkResult::interrupt();
    // Additions that are not exclusive become sums in registers, which do not
    // access memory.
    if (auto atomic = dyn_cast<AtomicOp>(op); atomic && !atomic.getExclusive())
      return WalkResult::advance();
    int64_t first = 0;
    std::optional<int64_t> stride = getStride(op, strips, **field, first);
    if (stride) {
      if (together++ == 0)
        origin = first;
      smallest = std::min(smallest, *stride);
      return WalkResult::advance();
    }
    ++apart;
    return isa<LoadOp>(op) ? WalkResult::advance() : WalkResult::interrupt();
  });
  if (result.wasInterrupted() || together == 0 || apart * 3 > together)
    return false;
  strips.width = std::clamp<int64_t>(kVectorBytes / smallest, 1, 4);
  int64_t lower = box.lower.back();
  int64_t past =
      ((lower - origin) % strips.width + strips.width) % strips.width;
  strips.first = lower - past;
  return strips.width > 1 &&
         box.upper.back() - lower >= kNarrowestTile * strips.width;
}

/// True if an iteration reads an element of a row other than its own.
static bool readsOtherRows(LoopBox &box) {
  Value row = box.ivs().drop_back().back();
  return box.loop.getBody()
      .walk([&](LoadOp load) {
        for (Value index : load.getIndices()) {
          SmallVector<Value> variables;
          if (index != row &&
              collectIndexVariables(index, box.loop.getBody(), variables) &&
              llvm::is_contained(variables, row))
            return WalkResult::interrupt();
        }
        return WalkResult::advance();
      })
      .wasInterrupted();
}

/// Chooses a tile size such that few tiles extend past the ends of the loop.
static void chooseTile(Strips &strips) {
  if (strips.getRank() < 2 || !readsOtherRows(strips.box))
    return;
  auto fits = [](int64_t count, int64_t size) {
    int64_t whole = llvm::divideCeilSigned(count, size) * size;
    return whole - count <= count / 8;
  };
  unsigned row = strips.getRank() - 2;
  int64_t rows = strips.box.upper[row] - strips.box.lower[row];
  for (int64_t width = kWidestTile; width >= kNarrowestTile; width /= 2)
    if (fits(strips.getNumStrips(), width) && fits(rows, kTileSize / width)) {
      strips.tileStrips = width;
      strips.tileRows = kTileSize / width;
      return;
    }
}

//===----------------------------------------------------------------------===//
// Rewriting
//===----------------------------------------------------------------------===//

namespace {
/// Clones the body for all elements of a strip, interleaved op by op.
class StripBuilder {
public:
  StripBuilder(OpBuilder &builder, const Strips &strips,
               std::vector<IRMapping> &elements)
      : builder(builder), elements(elements) {
    for (auto [value, chosen] : strips.same)
      same[value] = chosen;
  }

  void cloneBlock(Block &block);

private:
  void clone(Operation &op, IRMapping &element);
  Block *getTaken(scf::IfOp branch);

  OpBuilder &builder;
  std::vector<IRMapping> &elements;
  llvm::DenseMap<Value, Value> same;
};
} // namespace

/// Returns the arm of `branch` that all elements of the strip take; null if
/// they take different arms.
Block *StripBuilder::getTaken(scf::IfOp branch) {
  std::optional<bool> answer;
  for (IRMapping &element : elements) {
    std::optional<int64_t> known =
        getConstantIntValue(element.lookupOrDefault(branch.getCondition()));
    if (!known || (answer && *answer != (*known != 0)))
      return nullptr;
    answer = *known != 0;
  }
  return *answer ? branch.thenBlock() : branch.elseBlock();
}

void StripBuilder::clone(Operation &op, IRMapping &element) {
  // A condition that is constant in the interior has been mapped to its value,
  // so its op is not copied.
  if (op.getNumResults() == 1 && element.contains(op.getResult(0)))
    return;
  if (Value chosen =
          op.getNumResults() == 1 ? same.lookup(op.getResult(0)) : Value()) {
    element.map(op.getResult(0), element.lookupOrDefault(chosen));
    return;
  }
  Operation *copy = builder.clone(op, element);
  SmallVector<Value> folded;
  if (copy->getNumRegions() != 0 || !isPure(copy) ||
      failed(builder.tryFold(copy, folded)) || folded.empty())
    return;
  for (auto [result, value] : llvm::zip_equal(op.getResults(), folded))
    element.map(result, value);
  copy->erase();
}

void StripBuilder::cloneBlock(Block &block) {
  for (Operation &op : block.without_terminator()) {
    auto branch = dyn_cast<scf::IfOp>(op);
    // A branch whose condition is constant in each copy of the body has one
    // live arm.
    if (branch && llvm::all_of(elements, [&](IRMapping &element) {
          return getConstantIntValue(
                     element.lookupOrDefault(branch.getCondition()))
              .has_value();
        })) {
      if (Block *taken = getTaken(branch)) {
        cloneBlock(*taken);
        Operation *yield = taken->getTerminator();
        for (IRMapping &element : elements)
          for (auto [result, value] :
               llvm::zip(branch.getResults(), yield->getOperands()))
            element.map(result, element.lookupOrDefault(value));
      }
      continue;
    }
    for (IRMapping &element : elements)
      clone(op, element);
  }
}

/// Combines `condition` with the test that `index` is in [lower, upper).
static void addRangeTest(IndexMath &math, OpBuilder &builder, Location loc,
                         Value index, int64_t lower, int64_t upper,
                         Value &condition) {
  Value test = arith::CmpIOp::create(
      builder, loc, arith::CmpIPredicate::ult,
      arith::SubIOp::create(builder, loc, index, math.constant(lower)),
      math.constant(std::max<int64_t>(upper - lower, 0)));
  condition =
      condition
          ? arith::AndIOp::create(builder, loc, condition, test).getResult()
          : test;
}

static void rewrite(Strips &strips) {
  ParallelForOp loop = strips.box.loop;
  OpBuilder builder(loop);
  Location loc = loop.getLoc();
  IndexMath outside(builder, loc);
  unsigned rank = strips.getRank(), row = rank - 2;
  SmallVector<int64_t> from(strips.box.lower), to(strips.box.upper);
  int64_t numStrips = strips.getNumStrips(), numRows = 0;
  bool isTiled = strips.tileStrips != 0;
  from.back() = 0;
  to.back() = numStrips;
  if (isTiled) {
    numRows = to[row] - from[row];
    from[row] = 0;
    to[row] = llvm::divideCeil(numRows, strips.tileRows);
    to.back() = llvm::divideCeil(numStrips, strips.tileStrips);
    from.append(2, 0);
    to.append({strips.tileRows, strips.tileStrips});
  }
  auto constants = [&](ArrayRef<int64_t> values) {
    return llvm::map_to_vector(
        values, [&](int64_t value) { return outside.constant(value); });
  };
  auto cut =
      ParallelForOp::create(builder, loc, constants(from), constants(to));
  cut.copyNotesFrom(loop);

  // These are the loop indices of the first element of the strip.
  builder.setInsertionPointToStart(&cut.getBody().front());
  IndexMath math(builder, loc);
  SmallVector<Value> indices(cut.getInductionVars());
  // Tiles that extend past the end of the loop have additional rows and strips,
  // which are skipped.
  int64_t lastRow = 0, lastStrip = numStrips;
  if (isTiled) {
    Value strip = indices.pop_back_val(), inTile = indices.pop_back_val();
    lastRow = strips.box.lower[row] + to[row] * strips.tileRows;
    lastStrip = to[rank - 1] * strips.tileStrips;
    indices[row] =
        math.add(math.add(math.mul(indices[row], strips.tileRows), inTile),
                 math.constant(strips.box.lower[row]));
    indices.back() =
        math.add(math.mul(indices.back(), strips.tileStrips), strip);
  }
  indices.back() = math.add(math.mul(indices.back(), strips.width),
                            math.constant(strips.first));

  Value inside;
  for (unsigned k = 0; k + 1 < rank; ++k) {
    int64_t last = isTiled && k == row ? lastRow : strips.box.upper[k];
    if (strips.lower[k] > strips.box.lower[k] || strips.upper[k] < last)
      addRangeTest(math, builder, loc, indices[k], strips.lower[k],
                   strips.upper[k], inside);
  }
  if (strips.lower.back() > strips.first ||
      strips.upper.back() < strips.first + lastStrip * strips.width)
    addRangeTest(math, builder, loc, indices.back(), strips.lower.back(),
                 strips.upper.back() - strips.width + 1, inside);

  OpBuilder border = builder;
  if (inside) {
    auto branch = scf::IfOp::create(builder, loc, inside, /*withElse=*/true);
    builder.setInsertionPointToStart(branch.thenBlock());
    border.setInsertionPointToStart(branch.elseBlock());
  }
  std::vector<IRMapping> elements(strips.width);
  IndexMath interior(builder, loc);
  for (auto [k, element] : llvm::enumerate(elements)) {
    for (unsigned d = 0; d + 1 < rank; ++d)
      element.map(loop.getInductionVars()[d], indices[d]);
    element.map(loop.getInductionVars().back(),
                interior.add(indices.back(), interior.constant(k)));
    for (auto [condition, answer] : strips.answers)
      element.map(condition, arith::ConstantIntOp::create(
                                 builder, loc, static_cast<int64_t>(answer), 1)
                                 .getResult());
  }
  StripBuilder(builder, strips, elements).cloneBlock(loop.getBody().front());
  if (!inside) {
    loop.erase();
    return;
  }

  // At a border of the loop, a serial loop visits the elements of the strip one
  // after another.
  IndexMath outer(border, loc);
  if (isTiled && lastRow > strips.box.upper[row]) {
    Value isRow = arith::CmpIOp::create(border, loc, arith::CmpIPredicate::slt,
                                        indices[row],
                                        outer.constant(strips.box.upper[row]));
    auto branch = scf::IfOp::create(border, loc, isRow, /*withElse=*/false);
    border.setInsertionPointToStart(branch.thenBlock());
  }
  IndexMath rest(border, loc);
  Value begin =
      rest.max(indices.back(), rest.constant(strips.box.lower.back()));
  Value end = rest.min(rest.add(indices.back(), rest.constant(strips.width)),
                       rest.constant(strips.box.upper.back()));
  auto each = scf::ForOp::create(border, loc, begin, end, rest.constant(1));
  // LLVM must not unroll this loop at the border, because it would then merge
  // the loop with the interior.
  MLIRContext *context = loop.getContext();
  auto unroll = LLVM::LoopUnrollAttr::get(
      context, /*disable=*/BoolAttr::get(context, true), {}, {}, {}, {}, {},
      {});
  each->setAttr("llvm.loop_annotation",
                LLVM::LoopAnnotationAttr::get(context, {}, {}, {}, unroll, {},
                                              {}, {}, {}, {}, {}, {}, {}, {},
                                              {}, {}));
  Block &body = loop.getBody().front();
  body.getTerminator()->erase();
  each.getBody()->getOperations().splice(each.getBody()->begin(),
                                         body.getOperations());
  indices.back() = each.getInductionVar();
  for (auto [argument, index] : llvm::zip_equal(body.getArguments(), indices))
    argument.replaceAllUsesWith(index);
  loop.erase();
}

namespace {
struct CoarsenThreads : tai::impl::CoarsenThreadsBase<CoarsenThreads> {
  using Base::Base;

  void runOnOperation() override {
    Operation *table = SymbolTable::getNearestSymbolTable(getOperation());
    if (!table)
      return;
    std::optional<FieldTable> fields;
    for (LoopBox &box : findConstantBoxes(getOperation())) {
      // The terms of these sums have the order of the original iterations on
      // all targets, and strips would change it.
      if (hasCommonTotals(box.loop))
        continue;
      std::optional<int64_t> count = getNumIterations(box.loop);
      if (!count || *count < minIterations || !isSimple(box.loop, maxOps))
        continue;
      if (!fields)
        fields.emplace(table);
      Strips strips;
      strips.box = std::move(box);
      findInterior(strips);
      if (!chooseWidth(strips, *fields))
        continue;
      chooseTile(strips);
      rewrite(strips);
    }
  }
};
} // namespace
