//===- TaiPlugin.cpp - tai for a stock mlir-opt ---------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The plugin by which mlir-opt-22 knows tai, with the options
// --load-dialect-plugin=TaiPlugin.so --load-pass-plugin=TaiPlugin.so and, for
// example, --pass-pipeline='builtin.module(tai-to-llvm)'.
//
//===----------------------------------------------------------------------===//

#include "mlir/Tools/Plugins/DialectPlugin.h"
#include "mlir/Tools/Plugins/PassPlugin.h"
#include "tai-c/Version.h"
#include "tai/InitAll.h"

extern "C" LLVM_ATTRIBUTE_WEAK mlir::DialectPluginLibraryInfo
mlirGetDialectPluginInfo() {
  return {MLIR_PLUGIN_API_VERSION, "tai", TAI_VERSION_STRING,
          [](mlir::DialectRegistry *registry) {
            mlir::tai::registerAll(*registry);
          }};
}

extern "C" LLVM_ATTRIBUTE_WEAK mlir::PassPluginLibraryInfo
mlirGetPassPluginInfo() {
  return {MLIR_PLUGIN_API_VERSION, "tai", TAI_VERSION_STRING,
          mlir::tai::registerAllPasses};
}
