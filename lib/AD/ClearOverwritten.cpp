//===- ClearOverwritten.cpp - Forget adjoints of what was overwritten -----===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A store ends the life of the value that stood there: in a reverse sweep, the
// adjoint of the element belongs to the stored value, and that of the value
// before starts from zero. Adjoint kernels leave the zeroing out, because most
// elements are stored once. Where they are not, the tape runs what this pass
// makes after the adjoint.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/PatternMatch.h"
#include "mlir/Transforms/RegionUtils.h"
#include "tai/AD/Differentiable.h"
#include "tai/AD/Passes.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {
#define GEN_PASS_DEF_CLEAROVERWRITTEN
#include "tai/AD/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// Replaces a store by one of zero into the adjoint, if there is one.
static void clearAdjoint(StoreOp store) {
  FieldOp field = lookupField(store, store.getFieldAttr());
  Type type = store.getValue().getType();
  if (field && field.getAdjointAttr() && isFloatOrVector(field.getType())) {
    OpBuilder builder(store);
    Value zero = arith::ConstantOp::create(
        builder, store.getLoc(), cast<TypedAttr>(builder.getZeroAttr(type)));
    StoreOp::create(builder, store.getLoc(), zero, field.getAdjointAttr(),
                    store.getIndices(), store.getComponents());
  }
  store.erase();
}

/// True for what a kernel does to the world outside of it, stores aside.
static bool isOutput(Operation *op) {
  if (isa<AtomicOp, PrintOp, AssertOp, ActivateOp, DeactivateOp, AppendOp>(op))
    return true;
  Value array;
  if (auto store = dyn_cast<memref::StoreOp>(op))
    array = store.getMemRef();
  else if (auto atomic = dyn_cast<memref::AtomicRMWOp>(op))
    array = atomic.getMemref();
  return isa_and_present<BlockArgument>(array);
}

/// Gives a kernel no results.
static void dropResults(KernelOp kernel) {
  auto end = cast<ReturnOp>(kernel.getBody().front().getTerminator());
  end->setOperands({});
  kernel.setFunctionType(FunctionType::get(
      kernel.getContext(), kernel.getArgumentTypes(), TypeRange()));
  kernel.removeResAttrsAttr();
}

static LogicalResult clearOverwritten(KernelOp kernel) {
  SmallVector<StoreOp> stores;
  SmallVector<Operation *> outputs;
  kernel.walk([&](Operation *op) {
    if (auto store = dyn_cast<StoreOp>(op))
      stores.push_back(store);
    else if (isOutput(op))
      outputs.push_back(op);
  });
  for (StoreOp store : stores)
    clearAdjoint(store);
  dropResults(kernel);
  kernel.removeAdjointAttr();
  kernel.removeSummaryAttr();
  // What only the values of the stores needed goes with them, and then the
  // outputs that nothing uses.
  IRRewriter rewriter(kernel.getContext());
  (void)runRegionDCE(rewriter, kernel->getRegions());
  for (Operation *op : llvm::reverse(outputs)) {
    if (!op->use_empty())
      return op->emitError("the gradient needs to know which elements were "
                           "overwritten, and they depend on the result of this")
                 .attachNote()
             << "store to another element, such as one more time step of the "
                "field";
    op->erase();
  }
  (void)runRegionDCE(rewriter, kernel->getRegions());
  return success();
}

namespace {
struct ClearOverwritten : tai::impl::ClearOverwrittenBase<ClearOverwritten> {
  void runOnOperation() override {
    bool failedAny = false;
    getOperation()->walk([&](KernelOp kernel) {
      failedAny |= failed(clearOverwritten(kernel));
    });
    if (failedAny)
      signalPassFailure();
  }
};
} // namespace
