//===- NormalizeIndices.cpp - One form for shifted indices ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Programs write `x[i, (j - 1) % n]` in 32-bit arithmetic with a remainder and
// its correction for negative numbers. Where the bounds of the loop are known
// that is j - 1 wrapped once: a subtraction and a select on `index`, which
// later passes and the vectoriser understand.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "tai/Analysis/Index/IndexShift.h"
#include "tai/Analysis/IndexBounds.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"
#include "llvm/ADT/DenseMap.h"

namespace mlir::tai {
#define GEN_PASS_DEF_NORMALIZEINDICES
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// Emits the loop index `iv` shifted by `shift`, which may wrap at the bounds.
static Value createShift(OpBuilder &builder, Location loc, Value iv,
                         IndexShift shift, int64_t lower, int64_t upper) {
  if (shift.isIdentity())
    return iv;
  auto constant = [&](int64_t value) -> Value {
    return arith::ConstantIndexOp::create(builder, loc, value);
  };
  // Indices are far from the limits of their type, so the sums get the flag
  // `nsw`, by which LLVM finds neighbours in memory.
  auto add = [&](int64_t offset) -> Value {
    return arith::AddIOp::create(builder, loc, iv, constant(offset),
                                 arith::IntegerOverflowFlags::nsw);
  };
  Value moved = add(shift.offset);
  if (!shift.wraps)
    return moved;
  bool overEnd = shift.offset > 0;
  int64_t turn = overEnd ? lower - upper : upper - lower;
  Value isOutside = arith::CmpIOp::create(
      builder, loc,
      overEnd ? arith::CmpIPredicate::sge : arith::CmpIPredicate::slt, moved,
      constant(overEnd ? upper : lower));
  Value wrapped = add(shift.offset + turn);
  return arith::SelectOp::create(builder, loc, isOutside, wrapped, moved);
}

namespace {
struct NormalizeIndices : tai::impl::NormalizeIndicesBase<NormalizeIndices> {
  using Base::Base;

  void runOnOperation() override {
    getOperation()->walk([&](ParallelForOp loop) {
      if (checksIndices(loop))
        return;
      if (std::optional<LoopBox> box = getConstantBox(loop))
        normalize(*box);
    });
  }

private:
  void normalize(LoopBox &box) {
    // Index operands share expressions, so each expression is replaced once.
    llvm::DenseMap<Value, Value> replacements;
    OpBuilder builder(box.loop.getContext());
    builder.setInsertionPointToStart(&box.body());
    box.loop.getBody().walk([&](FieldAccessOpInterface op) {
      if (!op.isElementAccess())
        return;
      for (OpOperand &operand : op->getOpOperands()) {
        Value index = operand.get();
        if (!index.getType().isIndex() || !index.getDefiningOp() ||
            !box.loop->isProperAncestor(index.getDefiningOp()))
          continue;
        auto [entry, isNew] = replacements.try_emplace(index, index);
        if (isNew)
          entry->second = getReplacement(builder, box, index);
        operand.set(entry->second);
      }
    });
  }

  /// Returns `index` rewritten as a shift of one loop index, if it is one; else
  /// `index` itself.
  Value getReplacement(OpBuilder &builder, LoopBox &box, Value index) {
    SmallVector<Value> variables;
    if (!collectIndexVariables(index, box.loop.getBody(), variables) ||
        variables.size() != 1)
      return index;
    std::optional<unsigned> k = box.find(variables.front());
    if (!k)
      return index;
    std::optional<IndexShift> shift =
        getIndexShift(index, variables.front(), box.lower[*k], box.upper[*k]);
    if (!shift)
      return index;
    return createShift(builder, index.getLoc(), variables.front(), *shift,
                       box.lower[*k], box.upper[*k]);
  }
};
} // namespace
