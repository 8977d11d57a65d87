//===- CountWrites.cpp - Count activity tests of writes -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "CountWrites.h"
#include "tai/Analysis/SkipScope.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"

using namespace mlir;
using namespace mlir::tai;

void mlir::tai::countWrites(Operation *root) {
  llvm::DenseMap<FieldOp, bool> isSparse;
  root->walk([&](FieldAccessOpInterface op) {
    if (!op.isElementAccess() || !op.writesField())
      return;
    FieldOp field = lookupField(op, op.getFieldAttr());
    if (!field)
      return;
    auto [known, isNew] = isSparse.try_emplace(field, false);
    if (isNew) {
      FailureOr<FieldLayout> layout = getFieldLayout(field);
      known->second = succeeded(layout) && layout->path.getFirstSparse();
    }
    if (known->second)
      SkipScope::count(op->hasAttr(kActiveAttrName) ? SkipCount::WritesDemoted
                                                    : SkipCount::WritesKept);
  });
}
