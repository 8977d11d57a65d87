//===- KeepOrder.cpp - Loops of one thread --------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Marks loops whose results depend on the order of their iterations. Runs while
// loops still name the field that they visit: later, the indices of a loop over
// a sparse field are loaded from a list, which the analysis cannot see through.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/IterationOrder.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_KEEPORDER
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

namespace {
struct KeepOrder : tai::impl::KeepOrderBase<KeepOrder> {
  using Base::Base;

  void runOnOperation() override {
    getOperation()->walk([](ParallelForOp loop) {
      if (!loop.getSerialize() && dependsOnOrder(loop))
        loop.setInOrder(true);
    });
  }
};
} // namespace
