//===- SafeReads.cpp - Reads that any iteration may do --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "SafeReads.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Index/IntegerRanges.h"
#include "tai/Dialect/Tai/IR/Layout.h"

using namespace mlir;
using namespace mlir::tai;

/// True if the field has an element for each value that the indices may have.
bool SafeReads::isInside(FlatSymbolRefAttr field, ValueRange indices) const {
  FailureOr<FieldLayout> layout = getFieldLayout(lookupField(loop, field));
  if (failed(layout))
    return false;
  IntegerRanges ranges;
  return llvm::all_of(llvm::zip_equal(indices, layout->offset, layout->shape),
                      [&](auto dim) {
                        auto [index, first, extent] = dim;
                        ConstantIntRanges range = ranges.get(index);
                        return range.smin().getSExtValue() >= first &&
                               range.smax().getSExtValue() < first + extent;
                      });
}

/// True if the storage of `read` has an element wherever the storage of `other`
/// has one.
bool SafeReads::covers(DifferentiableAccessInterface read,
                       DifferentiableAccessInterface other) const {
  if (getStorageKey(read) == getStorageKey(other))
    return true;
  FlatSymbolRefAttr field = read.getAccessedStorage().field;
  FlatSymbolRefAttr otherField = other.getAccessedStorage().field;
  if (!field || !otherField)
    return false;
  FailureOr<FieldLayout> layout = getFieldLayout(lookupField(loop, field));
  FailureOr<FieldLayout> known = getFieldLayout(lookupField(loop, otherField));
  return succeeded(layout) && succeeded(known) &&
         layout->shape == known->shape && layout->offset == known->offset;
}

/// True if another iteration may write the element that `read` loads: a
/// condition around the read may be there to avoid this race.
bool SafeReads::mayBeWritten(DifferentiableAccessInterface read) const {
  return !same.reachSame(read, store) &&
         llvm::any_of(accesses, [&](DifferentiableAccessInterface other) {
           return other.getAccessKind() != AccessKind::Read &&
                  getStorageKey(other) == getStorageKey(read);
         });
}

bool SafeReads::contains(Operation *op, Operation *branch) const {
  auto read = dyn_cast<DifferentiableAccessInterface>(op);
  if (!read || read.getAccessKind() != AccessKind::Read)
    return false;
  bool areConstant = llvm::all_of(read.getAccessComponents(), [](Value part) {
    return matchPattern(part, m_Constant());
  });
  FlatSymbolRefAttr field = read.getAccessedStorage().field;
  bool isApart = areConstant && !mayBeWritten(read);
  if (field && isApart && isInside(field, read.getAccessIndices()))
    return true;
  // A read is safe if an earlier read of the loop, outside of the branch, has
  // the same index.
  return llvm::any_of(accesses, [&](DifferentiableAccessInterface other) {
    Operation *next = other->getBlock()->findAncestorOpInBlock(*branch);
    return other != read && other.getAccessKind() == AccessKind::Read && next &&
           other->isBeforeInBlock(next) &&
           (same.reachSame(other, read) ||
            (isApart && covers(read, other) &&
             same.areEqual(other.getAccessIndices(), read.getAccessIndices())));
  });
}
