//===- tai-reduce.cpp - Shrinks a failing .mlir file ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "ProgramReduction.h"
#include "common/OutputFile.h"
#include "common/Upstream.h"
#include "mlir/IR/MLIRContext.h"
#include "mlir/Tools/mlir-reduce/MlirReduceMain.h"
#include "tai/Dialect/Tai/IR/TextLimits.h"
#include "tai/InitAll.h"

int main(int argc, char **argv) {
  if (!mlir::tai::checkToolInput(argc, argv))
    return 1;
  mlir::tai::registerUpstreamPasses();
  mlir::tai::registerAllPasses();
  mlir::tai::registerProgramReduction();
  mlir::DialectRegistry registry;
  mlir::tai::registerUpstreamDialects(registry);
  mlir::tai::registerAll(registry);
  mlir::MLIRContext context(registry);
  return mlir::tai::runWithOutput(argc, argv, [&](int argc, char **argv) {
    return mlir::mlirReduceMain(argc, argv, context);
  });
}
