//===- LowerStructFor.cpp - Loops over fields to loops over boxes ---------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A field of dense levels has all its cells, so the loop over it is a box. The
// order of the dimensions is free: the one with the smallest stride becomes the
// innermost, so that consecutive iterations touch consecutive memory whatever
// the layout.
//
// A sparse field is a box too: its first dimension runs over the list of the
// active cells of the innermost sparse level, the others over the digits of the
// dense levels below. The indices of the field follow from the number of the
// cell and the digits.
//
//===----------------------------------------------------------------------===//

#include "CountWrites.h"
#include "tai/Analysis/Cost.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "tai/Analysis/SkipScope.h"
#include "tai/Conversion/Passes.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "tai/Transforms/Utils/ActiveCells.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"
#include "tai/Transforms/Utils/FieldAddress.h"
#include "tai/Transforms/Utils/IndexMath.h"

namespace mlir::tai {
#define GEN_PASS_DEF_LOWERSTRUCTFOR
#include "tai/Conversion/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// Returns the dimensions of a field, the dimension with the largest stride
/// first.
static SmallVector<unsigned> getMemoryOrder(const FieldInfo &field) {
  SmallVector<uint64_t> smallest(field.layout.shape.size(),
                                 std::numeric_limits<uint64_t>::max());
  for (const IndexDigit &digit : field.storage.digits)
    smallest[digit.dimension] =
        std::min(smallest[digit.dimension], digit.stride);
  auto order = llvm::to_vector(llvm::seq<unsigned>(0, smallest.size()));
  llvm::sort(order, [&](unsigned a, unsigned b) {
    return std::pair(smallest[a], b) > std::pair(smallest[b], a);
  });
  return order;
}

/// Moves the body of `loop` to the loop `box`, which replaces it.
static void moveBody(ParallelForOp loop, ParallelForOp box,
                     ValueRange indices) {
  Block *to = &box.getBody().front();
  Block *from = &loop.getBody().front();
  from->getTerminator()->erase();
  to->getOperations().splice(to->getTerminator()->getIterator(),
                             from->getOperations());
  for (auto [argument, index] : llvm::zip_equal(from->getArguments(), indices))
    argument.replaceAllUsesWith(index);
  loop.erase();
}

static ParallelForOp createBox(OpBuilder &builder, ParallelForOp loop,
                               ValueRange lower, ValueRange upper) {
  auto box = ParallelForOp::create(builder, loop.getLoc(), lower, upper);
  box.copyNotesFrom(loop);
  box.setSerialize(loop.getSerialize());
  return box;
}

/// Returns the digits (parts of indices) of a field whose level is in [first,
/// last), as dimensions of a loop over a box.
static SmallVector<const IndexDigit *>
getDigits(const FieldInfo &field, unsigned first, unsigned last) {
  SmallVector<const IndexDigit *> digits;
  for (const IndexDigit &digit : field.storage.digits)
    if (digit.level >= first && digit.level < last && digit.extent != 1)
      digits.push_back(&digit);
  return digits;
}

/// Replaces a loop over a sparse field, or over the cells of one of its levels,
/// by the box form. `last` is the number of levels that are looped over. With
/// `hoists`, the cell is located once for all its elements, otherwise for each
/// element.
static void lowerByDigits(ParallelForOp loop, const FieldInfo &field,
                          unsigned last, bool hoists) {
  double cost = estimateNanoseconds(loop.getBody().front());
  OpBuilder builder(loop);
  Location loc = loop.getLoc();
  IndexMath math(builder, loc);
  SmallVector<Value> lower, upper;
  const SparseInfo *sparse = nullptr;
  for (const SparseInfo &candidate : field.sparse)
    if (candidate.level < last)
      sparse = &candidate;
  unsigned first = 0;
  CellList cells;
  if (sparse) {
    Value base = emitTreeBase(builder, loc, field);
    cells = sparse->type.emitActiveCells(builder, loc, base, sparse->node);
    if (auto list = cells.count.getDefiningOp<ActiveCellsOp>())
      list.setReachAttr(loop.getReachAttr());
    lower.push_back(math.constant(0));
    upper.push_back(cells.count);
    first = sparse->level + 1;
  }
  SmallVector<const IndexDigit *> inner = getDigits(field, first, last);
  for (const IndexDigit *digit : inner) {
    lower.push_back(math.constant(0));
    upper.push_back(math.constant(digit->extent));
  }
  if (lower.empty()) {
    lower.push_back(math.constant(0));
    upper.push_back(math.constant(1));
  }
  ParallelForOp box = createBox(builder, loop, lower, upper);

  builder.setInsertionPointToStart(&box.getBody().front());
  SmallVector<Value> indices;
  for (int64_t start : field.layout.offset)
    indices.push_back(math.constant(start));
  auto add = [&](const IndexDigit &digit, Value value) {
    Value &index = indices[digit.dimension];
    index = math.add(math.mul(value, digit.divisor), index);
  };
  ArrayRef<BlockArgument> ivs = box.getInductionVars();
  if (sparse) {
    box.setOuterDims(1);
    if (!loop.getFixedCostAttr() && hasFixedBits(loop))
      box.setFixedCostAttr(builder.getF64FloatAttr(cost));
    Type i64 = builder.getI64Type();
    Value pointer = LLVM::GEPOp::create(
        builder, loc, cells.cells.getType(), i64, cells.cells,
        ArrayRef<LLVM::GEPArg>{math.toI64(ivs.front())},
        LLVM::GEPNoWrapFlags::inbounds | LLVM::GEPNoWrapFlags::nuw);
    ivs = ivs.drop_front();
    int64_t elements = 1;
    for (const IndexDigit *digit : inner)
      elements *= digit->extent;
    // The load is invariant: nothing writes to the list of cells while the
    // kernel runs.
    Value rest = math.toIndex(LLVM::LoadOp::create(
        builder, loc, i64, pointer, /*alignment=*/8, /*isVolatile=*/!hoists,
        /*isNonTemporal=*/false, /*isInvariant=*/hoists));
    SkipScope::count(SkipCount::CellsVisited, elements);
    SkipScope::count(SkipCount::CellsLocated, hoists ? 1 : elements);
    for (unsigned level = first; level-- > 0;) {
      int64_t count = field.layout.path.levels[level].type.getNumCells();
      Value cell = level == 0 ? rest : math.rem(rest, count);
      if (level != 0)
        rest = math.div(rest, count);
      for (const IndexDigit *digit : getDigits(field, level, level + 1)) {
        Value value = math.div(cell, digit->weight);
        // The outermost digit of a level is the quotient itself, without a
        // remainder.
        add(*digit, digit->weight * digit->extent == count
                        ? value
                        : math.rem(value, digit->extent));
      }
    }
  }
  for (auto [digit, iv] : llvm::zip(inner, ivs))
    add(*digit, iv);
  moveBody(loop, box, indices);
}

/// Replaces a loop in the form that visits a field by a loop over a box of
/// indices.
static void lower(ParallelForOp loop, const FieldInfo &field) {
  OpBuilder builder(loop);
  IndexMath math(builder, loop.getLoc());
  SmallVector<Value> lower, upper;
  SmallVector<unsigned> order = getMemoryOrder(field);
  // The single element of a field without dimensions is a loop of one trip.
  if (order.empty()) {
    lower.push_back(math.constant(0));
    upper.push_back(math.constant(1));
  }
  for (unsigned dimension : order) {
    int64_t first = field.layout.offset[dimension];
    lower.push_back(math.constant(first));
    upper.push_back(math.constant(first + field.layout.shape[dimension]));
  }
  ParallelForOp box = createBox(builder, loop, lower, upper);
  SmallVector<Value> indices(order.size());
  for (auto [position, dimension] : llvm::enumerate(order))
    indices[dimension] = box.getInductionVars()[position];
  moveBody(loop, box, indices);
}

namespace {
struct LowerStructFor : tai::impl::LowerStructForBase<LowerStructFor> {
  using Base::Base;

  void runOnOperation() override {
    Operation *table = SymbolTable::getNearestSymbolTable(getOperation());
    if (!table)
      return;
    const SkipSet skip = this->skip;
    std::optional<FieldTable> fields;
    SmallVector<std::pair<ParallelForOp, const FieldInfo *>> loops;
    WalkResult result = getOperation()->walk([&](ParallelForOp loop) {
      if (!loop.isStructFor())
        return WalkResult::advance();
      if (!fields)
        fields.emplace(table);
      FailureOr<const FieldInfo *> field =
          fields->lookup(loop, loop.getFieldAttr());
      if (failed(field))
        return WalkResult::interrupt();
      loops.push_back({loop, *field});
      return WalkResult::advance();
    });
    if (result.wasInterrupted())
      return signalPassFailure();
    for (auto [loop, field] : loops) {
      unsigned levels = field->layout.path.levels.size();
      if (skip.has(Skip::ActivityTests))
        markActive(loop, *fields);
      if (field->sparse.empty() && !loop.getLevel())
        lower(loop, *field);
      else
        lowerByDigits(loop, *field, levels + 1 - loop.getLevel().value_or(1),
                      skip.has(Skip::RepeatedLookups));
    }
    countWrites(getOperation());
  }
};
} // namespace
