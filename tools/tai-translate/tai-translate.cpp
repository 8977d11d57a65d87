//===- tai-translate.cpp - Translation between MLIR and others ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `--mlir-to-llvmir` prints the LLVM IR of the output of `tai-opt
// --tai-to-llvm`, `--tai-to-ptx` (in DeviceCode.cpp) prints the PTX of its
// device code, and `--tai-to-bytecode` (in ModuleFiles.cpp) writes the file
// that programs load.
//
//===----------------------------------------------------------------------===//

#include "DeviceCode.h"
#include "ModuleFiles.h"
#include "common/OutputFile.h"
#include "common/Upstream.h"
#include "mlir/Tools/mlir-translate/MlirTranslateMain.h"
#include "tai/Dialect/Tai/IR/TextLimits.h"

int main(int argc, char **argv) {
  if (!mlir::tai::checkToolInput(argc, argv))
    return 1;
  mlir::tai::registerUpstreamTranslations();
  mlir::tai::registerDeviceCodeTranslations();
  mlir::tai::registerModuleFileTranslations();
  return mlir::tai::runWithOutput(argc, argv, [](int argc, char **argv) {
    return mlir::mlirTranslateMain(argc, argv, "tai translation driver");
  });
}
