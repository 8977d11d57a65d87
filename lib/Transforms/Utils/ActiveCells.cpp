//===- ActiveCells.cpp - Cells that are known to be active ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Transforms/Utils/ActiveCells.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"

using namespace mlir;
using namespace mlir::tai;

/// True if equal indices select the same cell of the innermost sparse level
/// above both fields. The levels below that sparse level may differ.
static bool shareCells(const FieldInfo &a, const FieldInfo &b) {
  if (a.sparse.empty() || b.sparse.empty() || a.layout.tree != b.layout.tree ||
      a.sparse.back().node != b.sparse.back().node ||
      a.layout.offset != b.layout.offset)
    return false;
  auto digits = [](const FieldInfo &field) {
    return llvm::make_filter_range(
        field.storage.digits, [&](const IndexDigit &digit) {
          return digit.level <= field.sparse.back().level;
        });
  };
  return llvm::equal(digits(a), digits(b),
                     [](const IndexDigit &x, const IndexDigit &y) {
                       return x.dimension == y.dimension &&
                              x.divisor == y.divisor && x.extent == y.extent;
                     });
}

void tai::markActive(ParallelForOp loop, FieldTable &fields) {
  if (!loop.isStructFor() || loop.getLevel())
    return;
  FailureOr<const FieldInfo *> found = fields.lookup(loop, loop.getFieldAttr());
  if (failed(found) || (*found)->sparse.empty())
    return;
  const FieldInfo &field = **found;
  // A loop that deactivates cells gets no marks, since the cell of the
  // iteration may be one of these cells.
  WalkResult deactivates =
      loop.walk([](DeactivateOp) { return WalkResult::interrupt(); });
  if (deactivates.wasInterrupted())
    return;
  loop.walk([&](FieldAccessOpInterface op) {
    if (!op.isElementAccess() || !op.writesField())
      return;
    FailureOr<const FieldInfo *> other = fields.lookup(op, op.getFieldAttr());
    if (failed(other) || !shareCells(**other, field) ||
        !llvm::equal(op.getIndices(), loop.getInductionVars()))
      return;
    op->setAttr(kActiveAttrName, UnitAttr::get(op->getContext()));
  });
}
