//===- tai-lsp-server.cpp - Language server for .mlir files ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "InputFilter.h"
#include "OutputFilter.h"
#include "common/Upstream.h"
#include "mlir/IR/DialectRegistry.h"
#include "mlir/Tools/mlir-lsp-server/MlirLspServerMain.h"
#include "tai/InitAll.h"

int main(int argc, char **argv) {
  // In tests, lines separate the messages; `--lit-test` selects this, too.
  bool isDelimited = false, serves = true;
  for (llvm::StringRef word : llvm::ArrayRef(argv + 1, argc - 1)) {
    isDelimited |= word.ends_with("lit-test") || word.ends_with("=delimited");
    llvm::StringRef name = word.ltrim('-');
    serves &= !name.starts_with("help") && name != "h" && name != "version";
  }
  if (serves)
    mlir::tai::filterStandardOutput(isDelimited);
  mlir::tai::filterStandardInput(isDelimited);
  mlir::DialectRegistry registry;
  mlir::tai::registerUpstreamDialects(registry);
  mlir::tai::registerAll(registry);
  llvm::LogicalResult result = mlir::MlirLspServerMain(argc, argv, registry);
  mlir::tai::finishStandardOutput();
  return mlir::failed(result);
}
