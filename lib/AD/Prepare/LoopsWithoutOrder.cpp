//===- LoopsWithoutOrder.cpp - Stores of loops without an order -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// If several iterations of `scf.parallel` store to one element, any of their
// values may remain, and the gradient would be that of an arbitrary one.
//
//===----------------------------------------------------------------------===//

#include "LoopsWithoutOrder.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Index/IndexBuilder.h"
#include "tai/Analysis/Index/IndexQueries.h"
#include "llvm/ADT/MapVector.h"

using namespace mlir;
using namespace mlir::tai;

/// Returns the dimensions in which the loop may have more than one iteration.
static SmallVector<Value> getMovingDimensions(scf::ParallelOp loop) {
  SmallVector<Value> moving;
  for (auto [iv, lower, upper, step] :
       llvm::zip(loop.getInductionVars(), loop.getLowerBound(),
                 loop.getUpperBound(), loop.getStep())) {
    std::optional<int64_t> from = getConstantIntValue(lower),
                           to = getConstantIntValue(upper),
                           by = getConstantIntValue(step);
    if (!from || !to || !by || *to - *from > *by)
      moving.push_back(iv);
  }
  return moving;
}

LogicalResult mlir::tai::checkLoopsWithoutOrder(FunctionOpInterface function,
                                                const Activity &activity) {
  LogicalResult result = success();
  function.getFunctionBody().walk([&](scf::ParallelOp loop) {
    SmallVector<Value> moving = getMovingDimensions(loop);
    llvm::MapVector<const void *, SmallVector<DifferentiableAccessInterface>>
        storages;
    loop.walk([&](DifferentiableAccessInterface access) {
      Value memref = access.getAccessedStorage().memref;
      if (access.getAccessKind() == AccessKind::Write &&
          !matchPattern(access.getAccessedValue(), m_Constant()) &&
          !(memref && loop->isAncestor(memref.getParentBlock()->getParentOp())))
        storages[getStorageKey(access)].push_back(access);
    });
    for (auto &[key, stores] : storages) {
      SmallVector<IndexExpr> indices =
          getIndexExprs(stores.front().getAccessIndices());
      SmallVector<IndexExpr> common;
      for (size_t i = 0; i != indices.size(); ++i)
        if (llvm::all_of(stores, [&](auto store) {
              return getIndexExpr(store.getAccessIndices()[i]) == indices[i];
            }))
          common.push_back(indices[i]);
      bool isActive = llvm::any_of(
          stores, [&](auto store) { return activity.isActiveAccess(store); });
      if (!isActive || moving.empty() || isInjectiveOver(common, moving))
        continue;
      InFlightDiagnostic diag = stores.front()->emitError(
          "iterations of a parallel loop may store to the same element here, "
          "and the gradient belongs to the one whose value remains");
      diag.attachNote(loop.getLoc())
          << "the iterations of 'scf.parallel' have no order, so that none of "
             "them is the last";
      diag.attachNote() << "store to an element for each iteration, or write "
                           "the loop as 'tai.parallel_for' or as 'scf.for'";
      result = failure();
    }
  });
  return result;
}
