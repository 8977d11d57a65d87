//===- TestFailure.cpp - A pass that fails --------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// For tests of how internal errors of passes are reported.
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/Builders.h"
#include "mlir/Pass/Pass.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_TESTFAILURE
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

namespace {
struct TestFailure : tai::impl::TestFailureBase<TestFailure> {
  using Base::Base;

  void runOnOperation() override {
    if (!findTaiOp(getOperation()))
      return;
    if (!invalid)
      return signalPassFailure();
    // This pass makes an invalid op: a return outside of any kernel.
    OpBuilder builder = OpBuilder::atBlockEnd(getOperation().getBody());
    ReturnOp::create(builder, getOperation().getLoc(), ValueRange());
  }
};
} // namespace
