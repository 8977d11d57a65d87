//===- contexts.cpp - tai in several MLIRContexts of one program ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A host with command-line options of its own, in which threads take kernels
// through whole pipelines, each in a context of its own, and make and destroy
// contexts meanwhile. All must come to the same module.
//
//   contexts [-rounds=N] file.mlir
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/BuiltinOps.h"
#include "mlir/Parser/Parser.h"
#include "mlir/Pass/PassManager.h"
#include "tai/InitAll.h"
#include "llvm/Support/CommandLine.h"
#include <thread>
#include <vector>

using namespace mlir;

static llvm::cl::opt<std::string> file(llvm::cl::Positional,
                                       llvm::cl::Required);
static llvm::cl::opt<int> rounds("rounds", llvm::cl::init(4));
// Names that a library might want for itself.
static llvm::cl::opt<bool> cache("cache"), debugMode("tai-debug"),
    arch("tai-arch");

/// The lowered kernels of the file, or nothing.
static std::string lower(MLIRContext &context) {
  auto module = parseSourceFile<ModuleOp>(file, &context);
  if (!module)
    return {};
  PassManager pm(&context);
  tai::buildPipeline(pm, tai::ToLLVMOptions());
  if (failed(pm.run(*module)))
    return {};
  std::string text;
  llvm::raw_string_ostream stream(text);
  module->print(stream);
  return text;
}

int main(int argc, char **argv) {
  llvm::cl::ParseCommandLineOptions(argc, argv);
  DialectRegistry registry;
  tai::registerAll(registry);
  MLIRContext first(registry), second(registry);
  std::string expected = lower(first);
  if (expected.empty() || lower(second) != expected)
    return 1;

  std::vector<int> wrong(3);
  std::vector<std::thread> threads;
  for (int &mine : wrong)
    threads.emplace_back([&] {
      for (int round = 0; round < rounds; ++round) {
        MLIRContext context(registry, MLIRContext::Threading::DISABLED);
        mine += lower(context) != expected;
      }
    });
  for (std::thread &thread : threads)
    thread.join();
  int all = 0;
  for (int mine : wrong)
    all += mine;
  llvm::outs() << rounds * wrong.size() << " contexts, " << all << " wrong\n";
  return all != 0;
}
