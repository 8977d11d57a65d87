//===- VectorizeBlocks.cpp - Loops over blocks, a row at a time -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A stencil on blocks reads across their borders: the neighbour of the last
// element of a row lies in another block, and no loop over the elements of a
// row has an affine address. But the neighbours of a whole row are parts of two
// rows with known addresses. So the loop over elements becomes one over blocks,
// and in the interior the rows of a block are vectors: two loads and a shuffle
// replace the gather.
//
//===----------------------------------------------------------------------===//

#include "RowBuilder.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Analysis/IndexBounds.h"
#include "tai/Analysis/SkipScope.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Utils/ActiveCells.h"

namespace mlir::tai {
#define GEN_PASS_DEF_VECTORIZEBLOCKS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// Emits the test whether the block at `origin` is in the interior; null if all
/// blocks are.
static Value emitIsInterior(OpBuilder &builder, const BlockLoop &block,
                            ValueRange origin) {
  Location loc = ParallelForOp(block.loop).getLoc();
  IndexMath math(builder, loc);
  Value inside;
  const FieldLayout &layout = block.field->layout;
  for (auto [d, index] : llvm::enumerate(origin)) {
    int64_t lower = block.lower[d], upper = block.upper[d];
    if (lower == layout.offset[d] &&
        upper == layout.offset[d] + layout.shape[d])
      continue;
    // One unsigned comparison checks both ends of the range, because an index
    // below `lower` wraps to a large number.
    Value holds = arith::CmpIOp::create(
        builder, loc, arith::CmpIPredicate::ule, math.sub(index, lower),
        math.constant(upper - block.extents[d] - lower));
    inside =
        inside ? arith::AndIOp::create(builder, loc, inside, holds).getResult()
               : holds;
  }
  return inside;
}

/// Emits the activation of cells of other fields to which the block writes.
/// Returns an i1: true if these cells and the neighbours are active and
/// `inside` holds.
static Value emitActivations(OpBuilder &builder, const BlockLoop &block,
                             ValueRange origin, Value inside, bool keeps) {
  Location loc = ParallelForOp(block.loop).getLoc();
  if (block.activations.empty() && block.neighbours.empty())
    return inside;
  scf::IfOp branch;
  OpBuilder inner = builder;
  if (inside) {
    branch = scf::IfOp::create(builder, loc, builder.getI1Type(), inside,
                               /*addThenBlock=*/true, /*addElseBlock=*/true);
    inner = OpBuilder::atBlockEnd(branch.elseBlock());
    scf::YieldOp::create(inner, loc, inside);
    inner = OpBuilder::atBlockBegin(branch.thenBlock());
  }
  Value all;
  auto require = [&](Value holds) {
    all =
        all ? arith::AndIOp::create(inner, loc, all, holds).getResult() : holds;
  };
  IndexMath math(inner, loc);
  for (const BlockLoop::Neighbour &neighbour : block.neighbours) {
    SmallVector<Value> indices;
    for (auto [index, distance, extent] :
         llvm::zip(origin, neighbour.distance, block.extents))
      indices.push_back(math.add(index, math.constant(distance * extent)));
    require(IsActiveOp::create(inner, loc, inner.getI1Type(), neighbour.field,
                               indices, inner.getI64IntegerAttr(neighbour.up)));
  }
  for (const BlockAccess *access : block.activations) {
    FlatSymbolRefAttr name = getNamedField(access->op);
    IntegerAttr up =
        builder.getI64IntegerAttr(access->field->layout.path.levels.size() -
                                  access->field->sparse.back().level);
    Value active =
        IsActiveOp::create(inner, loc, inner.getI1Type(), name, origin, up);
    if (!keeps) {
      auto known = scf::IfOp::create(inner, loc, inner.getI1Type(), active,
                                     /*addThenBlock=*/true,
                                     /*addElseBlock=*/true);
      OpBuilder then = OpBuilder::atBlockBegin(known.thenBlock());
      scf::YieldOp::create(then, loc, active);
      // The activation may fail for want of memory, so the cell is tested
      // again.
      OpBuilder otherwise = OpBuilder::atBlockBegin(known.elseBlock());
      ActivateOp::create(otherwise, loc, name, origin, up);
      active = IsActiveOp::create(otherwise, loc, otherwise.getI1Type(), name,
                                  origin, up);
      scf::YieldOp::create(otherwise, loc, active);
      active = known.getResult(0);
    }
    require(active);
  }
  if (!branch)
    return all;
  scf::YieldOp::create(inner, loc, all);
  return branch.getResult(0);
}

/// Calls `body` with the distances of each row from the first row. Rows are
/// unrolled, with constant distances, as long as `limit` allows the copies.
static void
forEachRow(OpBuilder &builder, const BlockLoop &block, int64_t limit,
           function_ref<void(ArrayRef<OpFoldResult> distances)> body) {
  Location loc = ParallelForOp(block.loop).getLoc();
  // The dimensions with more than one row, the outermost first.
  SmallVector<std::pair<uint64_t, unsigned>> order;
  for (const IndexDigit &digit : block.field->storage.digits)
    if (digit.divisor == 1 && block.extents[digit.dimension] > 1 &&
        digit.dimension != block.rowDimension)
      order.push_back({digit.stride, digit.dimension});
  llvm::sort(order, std::greater<>());
  // The innermost dimensions of the rows are unrolled.
  size_t loops = order.size();
  for (int64_t copies = 1; loops > 0; --loops) {
    copies *= block.extents[order[loops - 1].second];
    if (copies > limit)
      break;
  }
  SmallVector<OpFoldResult> distances(block.extents.size(),
                                      builder.getIndexAttr(0));
  OpBuilder::InsertionGuard guard(builder);
  IndexMath math(builder, loc);
  for (auto [stride, d] : ArrayRef(order).take_front(loops)) {
    auto rows =
        scf::ForOp::create(builder, loc, math.constant(0),
                           math.constant(block.extents[d]), math.constant(1));
    distances[d] = rows.getInductionVar();
    builder.setInsertionPointToStart(rows.getBody());
  }
  ArrayRef<std::pair<uint64_t, unsigned>> unrolled =
      ArrayRef(order).drop_front(loops);
  int64_t count = 1;
  for (auto [stride, d] : unrolled)
    count *= block.extents[d];
  for (int64_t row = 0; row < count; ++row) {
    int64_t rest = row;
    for (auto [stride, d] : llvm::reverse(unrolled)) {
      distances[d] = builder.getIndexAttr(rest % block.extents[d]);
      rest /= block.extents[d];
    }
    body(distances);
  }
}

/// Emits the iterations of a block one after another, with the original body.
static void emitElements(OpBuilder &builder, const BlockLoop &block,
                         ValueRange origin) {
  ParallelForOp loop = block.loop;
  Location loc = loop.getLoc();
  OpBuilder::InsertionGuard guard(builder);
  IndexMath math(builder, loc);
  SmallVector<Value> indices(origin);
  // No loop is unrolled here: the loops visit the elements in memory order, the
  // row innermost.
  forEachRow(builder, block, /*limit=*/0, [&](ArrayRef<OpFoldResult> rows) {
    auto row =
        scf::ForOp::create(builder, loc, math.constant(0),
                           math.constant(block.rowLength()), math.constant(1));
    OpBuilder inner = OpBuilder::atBlockBegin(row.getBody());
    IndexMath innerMath(inner, loc);
    for (auto [d, distance] : llvm::enumerate(rows)) {
      Value step = d == block.rowDimension
                       ? row.getInductionVar()
                       : dyn_cast_if_present<Value>(distance);
      if (step)
        indices[d] = innerMath.add(origin[d], step);
    }
    IRMapping mapping;
    mapping.map(loop.getInductionVars(), indices);
    for (Operation &op : loop.getBody().front().without_terminator())
      inner.clone(op, mapping);
  });
}

static void vectorize(const BlockLoop &block, FieldTable &fields,
                      int64_t maxOps) {
  ParallelForOp loop = block.loop;
  auto kernel = loop->getParentOfType<KernelOp>();
  bool keeps = kernel && kernel.getKeepsActivity();
  OpBuilder builder(loop);
  Location loc = loop.getLoc();
  auto blocks = ParallelForOp::create(builder, loc, loop.getFieldAttr(),
                                      block.extents.size());
  blocks.copyNotesFrom(loop);
  blocks.setLevel(2);

  builder.setInsertionPointToStart(&blocks.getBody().front());
  auto ivs = blocks.getInductionVars();
  SmallVector<Value> origin(ivs.begin(), ivs.end());
  // tai-lower-struct-for counts the first element of each block as visited; the
  // other elements are counted here.
  int64_t elements = 1;
  for (int64_t extent : block.extents)
    elements *= extent;
  if (!block.field->sparse.empty())
    SkipScope::count(SkipCount::CellsVisited, elements - 1);
  Value inside = emitIsInterior(builder, block, origin);
  inside = emitActivations(builder, block, origin, inside, keeps);
  if (inside) {
    // The vector path is marked as likely, because the other path is long, and
    // should take no registers from it.
    Value likely = arith::ConstantIntOp::create(builder, loc, 1, 1);
    inside = LLVM::ExpectOp::create(builder, loc, inside, likely);
    auto branch = scf::IfOp::create(builder, loc, inside,
                                    /*withElseRegion=*/true);
    builder.setInsertionPointToStart(branch.elseBlock());
    emitElements(builder, block, origin);
    builder.setInsertionPointToStart(branch.thenBlock());
  }
  // If there are two paths, the writes are counted in the scalar one.
  for (const auto &[op, access] : block.accesses)
    if (!inside && !isa<LoadOp>(op) && !access.field->sparse.empty())
      SkipScope::count(SkipCount::WritesDemoted);
  RowBuilder rows(builder, block, fields, origin);
  forEachRow(builder, block, maxOps / std::max<int64_t>(block.numOps, 1),
             [&](ArrayRef<OpFoldResult> at) { rows.emitRow(at); });
  loop.erase();
}

namespace {
struct VectorizeBlocks : tai::impl::VectorizeBlocksBase<VectorizeBlocks> {
  using Base::Base;

  void runOnOperation() override {
    Operation *table = SymbolTable::getNearestSymbolTable(getOperation());
    if (!table)
      return;
    SmallVector<ParallelForOp> loops;
    getOperation()->walk([&](ParallelForOp loop) {
      if (loop.isStructFor() && !checksIndices(loop))
        loops.push_back(loop);
    });
    if (loops.empty())
      return;
    FieldTable fields(table);
    // All fields are looked up first, because the alias scopes of accesses name
    // other fields.
    WalkResult known = getOperation()->walk([&](Operation *op) {
      FlatSymbolRefAttr name = getNamedField(op);
      return name && failed(fields.lookup(op, name)) ? WalkResult::interrupt()
                                                     : WalkResult::advance();
    });
    if (known.wasInterrupted())
      return signalPassFailure();
    for (ParallelForOp loop : loops) {
      markActive(loop, fields);
      if (std::optional<BlockLoop> block = BlockLoop::analyze(loop, fields))
        vectorize(*block, fields, maxOps);
    }
  }
};
} // namespace
