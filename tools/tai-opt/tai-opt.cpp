//===- tai-opt.cpp - The optimizer driver ---------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Runs passes and pipelines on `.mlir` files: those of tai, such as
// `--tai-autodiff` and `--tai-to-llvm`, and all of upstream.
//
//===----------------------------------------------------------------------===//

#include "common/OutputFile.h"
#include "common/Upstream.h"
#include "mlir/IR/DialectRegistry.h"
#include "mlir/Tools/mlir-opt/MlirOptMain.h"
#include "tai/Dialect/Tai/IR/TextLimits.h"
#include "tai/InitAll.h"

int main(int argc, char **argv) {
  if (!mlir::tai::checkToolInput(argc, argv))
    return 1;
  mlir::DialectRegistry registry;
  mlir::tai::registerUpstreamDialects(registry);
  mlir::tai::registerAll(registry);
  mlir::tai::registerUpstreamPasses();
  mlir::tai::registerAllPasses();
  return mlir::tai::runWithOutput(argc, argv, [&](int argc, char **argv) {
    return mlir::MlirOptMain(argc, argv, "tai optimizer driver\n", registry);
  });
}
