//===- InjectedFailures.cpp - Failures injected by tests ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/InjectedFailures.h"
#include "mlir/Pass/PassManager.h"
#include "tai/Transforms/Passes.h"

using namespace mlir;
using namespace mlir::tai;

void mlir::tai::injectFailingPass(OpPassManager &manager, StringRef place) {
  TestFailureOptions options;
  options.invalid = injectsFailure((place + "-invalid").str());
  if (options.invalid || injectsFailure(place))
    manager.addPass(createTestFailure(options));
}
