//===- PerfMap.cpp - Names of compiled functions for perf -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "PerfMap.h"
#include "llvm/ADT/SmallPtrSet.h"
#include "llvm/ExecutionEngine/JITLink/JITLink.h"
#include "llvm/ExecutionEngine/Orc/LinkGraphLinkingLayer.h"
#include "llvm/Support/FileSystem.h"
#include "llvm/Support/FormatVariadic.h"
#include "llvm/Support/Process.h"
#include "llvm/Support/raw_ostream.h"
#include <cstdlib>
#include <mutex>
#include <vector>

using namespace llvm;
using namespace llvm::orc;

namespace {
class PerfMap : public LinkGraphLinkingLayer::Plugin {
public:
  explicit PerfMap(std::unique_ptr<raw_fd_ostream> file)
      : file(std::move(file)) {}

  void modifyPassConfig(MaterializationResponsibility &, jitlink::LinkGraph &,
                        jitlink::PassConfiguration &passes) override {
    // Functions are recorded before pruning: unreferenced symbols are dropped
    // although their code stays, because the assembler refers to local
    // functions by their section.
    auto functions = std::make_shared<std::vector<Function>>();
    passes.PrePrunePasses.push_back([functions](jitlink::LinkGraph &graph) {
      for (jitlink::Symbol *symbol : graph.defined_symbols())
        if (symbol->hasName() && isCode(*symbol))
          functions->push_back({&symbol->getBlock(), symbol->getOffset(),
                                symbol->getSize(), symbol->getName()});
      return Error::success();
    });
    passes.PostFixupPasses.push_back(
        [this, functions](jitlink::LinkGraph &graph) {
          write(graph, *functions);
          return Error::success();
        });
  }
  Error notifyFailed(MaterializationResponsibility &) override {
    return Error::success();
  }
  Error notifyRemovingResources(JITDylib &, ResourceKey) override {
    return Error::success();
  }
  void notifyTransferringResources(JITDylib &, ResourceKey,
                                   ResourceKey) override {}

private:
  struct Function {
    jitlink::Block *block;
    orc::ExecutorAddrDiff offset;
    orc::ExecutorAddrDiff size;
    SymbolStringPtr name;
  };

  static bool isCode(const jitlink::Symbol &symbol) {
    MemProt access = symbol.getSection().getMemProt();
    return (access & MemProt::Exec) != MemProt::None && symbol.getSize() > 0;
  }

  void write(jitlink::LinkGraph &graph, ArrayRef<Function> functions) {
    SmallPtrSet<jitlink::Block *, 8> kept;
    kept.insert_range(graph.blocks());
    std::lock_guard<std::mutex> lock(mutex);
    for (const Function &function : functions)
      if (kept.contains(function.block))
        *file << formatv(
            "{0:x-} {1:x-} {2}\n",
            (function.block->getAddress() + function.offset).getValue(),
            function.size, *function.name);
    file->flush();
  }

  std::unique_ptr<raw_fd_ostream> file;
  std::mutex mutex;
};
} // namespace

void mlir::tai::addPerfMap(LinkGraphLinkingLayer &layer) {
  const char *given = std::getenv("TAI_PERF_MAP");
  if (!given || StringRef(given) != "1")
    return;
  std::error_code failed;
  auto file = std::make_unique<raw_fd_ostream>(
      formatv("/tmp/perf-{0}.map", sys::Process::getProcessId()).str(), failed,
      sys::fs::OF_Append);
  if (!failed)
    layer.addPlugin(std::make_shared<PerfMap>(std::move(file)));
}
