//===- ActivityChanges.cpp - Activity in kernels that are reversed --------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Deactivation overwrites with zeros whatever lies below a cell, as no store
// says. A tape undoes that between two launches, and an adjoint cannot do so
// in the middle of one.
//
//===----------------------------------------------------------------------===//

#include "tai/AD/AdjointBuilder.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

void AdjointBuilder::checkActivityChanges() {
  auto treeOf = [](Operation *op, FlatSymbolRefAttr name) {
    FieldOp field = name ? lookupField(op, name) : FieldOp();
    return field ? field.getTreeAttr() : FlatSymbolRefAttr();
  };
  // The accesses that matter, by tree.
  DenseMap<Attribute, Operation *> accessed;
  bool any = false;
  primal.walk([&](DifferentiableAccessInterface access) {
    any |= activity.isActiveAccess(access);
    if (FlatSymbolRefAttr tree =
            treeOf(access, access.getAccessedStorage().field))
      accessed.try_emplace(tree, access);
  });
  if (!any)
    return;
  primal.walk([&](DeactivateOp op) {
    Operation *access = accessed.lookup(treeOf(op, op.getFieldAttr()));
    if (!access)
      return;
    emitError(op, "cannot differentiate a kernel that deactivates cells of a "
                  "tree which it reads or writes")
            .attachNote(access->getLoc())
        << "reads or writes it here; deactivate in a kernel of its own, or by "
           "'deactivate_all' between kernels";
  });
}
