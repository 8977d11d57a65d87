//===- tai-translate.cpp - Translation between MLIR and others ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `--mlir-to-llvmir` prints the LLVM IR of what `tai-opt --tai-to-llvm` made.
//
//===----------------------------------------------------------------------===//

#include "common/Upstream.h"
#include "mlir/Tools/mlir-translate/MlirTranslateMain.h"

int main(int argc, char **argv) {
  mlir::tai::registerUpstreamTranslations();
  return mlir::failed(
      mlir::mlirTranslateMain(argc, argv, "tai translation driver"));
}
