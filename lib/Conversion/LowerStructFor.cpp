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
//===----------------------------------------------------------------------===//

#include "Common/FieldAddress.h"
#include "Common/IndexMath.h"
#include "tai/Conversion/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_LOWERSTRUCTFOR
#include "tai/Conversion/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// The dimensions of a field, that with the largest stride first.
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

/// Replaces the field form of `loop` by the box form.
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
  auto box = ParallelForOp::create(builder, loop.getLoc(), lower, upper);
  box->setDiscardableAttrs(loop->getDiscardableAttrDictionary());
  box.setSerialize(loop.getSerialize());
  box.setBlockDimAttr(loop.getBlockDimAttr());

  Block *to = &box.getBody().front();
  Block *from = &loop.getBody().front();
  to->getTerminator()->erase();
  to->getOperations().splice(to->end(), from->getOperations());
  for (auto [position, dimension] : llvm::enumerate(order))
    from->getArgument(dimension).replaceAllUsesWith(to->getArgument(position));
  loop.erase();
}

namespace {
struct LowerStructFor : tai::impl::LowerStructForBase<LowerStructFor> {
  using Base::Base;

  void runOnOperation() override {
    Operation *table = SymbolTable::getNearestSymbolTable(getOperation());
    if (!table)
      return;
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
    for (auto [loop, field] : loops)
      lower(loop, *field);
  }
};
} // namespace
