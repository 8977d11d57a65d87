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

#include "ExplainPasses.h"
#include "PassStatistics.h"
#include "common/OutputFile.h"
#include "common/Upstream.h"
#include "mlir/IR/DialectRegistry.h"
#include "mlir/Pass/PassManager.h"
#include "mlir/Support/FileUtilities.h"
#include "mlir/Tools/mlir-opt/MlirOptMain.h"
#include "tai/Dialect/Tai/IR/TextLimits.h"
#include "tai/InitAll.h"
#include "llvm/Support/CommandLine.h"
#include "llvm/Support/MemoryBuffer.h"
#include "llvm/Support/ToolOutputFile.h"

using namespace mlir;

/// Does the work of MlirOptMain, with a manager of passes that `observe` has
/// seen.
static LogicalResult
runObserved(StringRef input, StringRef output, DialectRegistry &registry,
            llvm::function_ref<void(PassManager &)> observe) {
  MlirOptMainConfig given = MlirOptMainConfig::createFromCLOptions();
  MlirOptMainConfig config = given;
  config.setPassPipelineSetupFn([given, observe](PassManager &manager) {
    observe(manager);
    return given.setupPassPipeline(manager);
  });
  std::string reason;
  std::unique_ptr<llvm::MemoryBuffer> buffer = openInputFile(input, &reason);
  std::unique_ptr<llvm::ToolOutputFile> file =
      buffer ? openOutputFile(output, &reason) : nullptr;
  if (!file) {
    llvm::errs() << reason << '\n';
    return failure();
  }
  if (failed(MlirOptMain(file->os(), std::move(buffer), registry, config)))
    return failure();
  file->keep();
  return success();
}

int main(int argc, char **argv) {
  if (!tai::checkToolInput(argc, argv))
    return 1;
  DialectRegistry registry;
  tai::registerUpstreamDialects(registry);
  tai::registerAll(registry);
  tai::registerUpstreamPasses();
  tai::registerAllPasses();
  llvm::cl::opt<bool> explain(
      "tai-explain",
      llvm::cl::desc("Report for each kernel and function which passes changed "
                     "it and how, with their remarks, on standard error"));
  return tai::runWithOutput(argc, argv, [&](int argc, char **argv) {
    auto [input, output] = registerAndParseCLIOptions(
        argc, argv, "tai optimizer driver\n", registry);
    if (explain)
      return runObserved(input, output, registry, tai::explainPasses);
    // Upstream's report is empty: its counters are compiled out.
    if (llvm::cl::Option *option =
            llvm::cl::getRegisteredOptions().lookup("mlir-pass-statistics");
        option && option->getNumOccurrences()) {
      tai::PassStatistics statistics;
      LogicalResult result =
          runObserved(input, output, registry, [&](PassManager &manager) {
            statistics.observe(manager);
          });
      statistics.print(llvm::errs());
      return result;
    }
    return MlirOptMain(argc, argv, input, output, registry);
  });
}
