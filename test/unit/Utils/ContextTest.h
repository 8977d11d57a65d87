//===- ContextTest.h - Tests with a context of MLIR -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TEST_UNIT_COMPILER_CONTEXTTEST_H
#define TEST_UNIT_COMPILER_CONTEXTTEST_H

#include "tai/InitAll.h"
#include "gtest/gtest.h"

namespace mlir::tai {

/// A context with all dialects of the project, loaded.
class ContextTest : public ::testing::Test {
protected:
  ContextTest() : context(getRegistry()) { context.loadAllAvailableDialects(); }

  MLIRContext context;

private:
  static DialectRegistry getRegistry() {
    DialectRegistry registry;
    registerAll(registry);
    return registry;
  }
};

} // namespace mlir::tai

#endif // TEST_UNIT_COMPILER_CONTEXTTEST_H
