//===- ModuleFiles.cpp - Bytecode with a checksum -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `--tai-to-bytecode` writes the bytecode format of taiKernelLoad, and
// `--tai-from-bytecode` reads it.
//
//===----------------------------------------------------------------------===//

#include "ModuleFiles.h"
#include "common/Upstream.h"
#include "mlir/Tools/mlir-translate/Translation.h"
#include "tai/ExecutionEngine/Modules/ModuleFile.h"
#include "tai/InitAll.h"
#include "llvm/Support/MemoryBuffer.h"
#include "llvm/Support/SourceMgr.h"

using namespace mlir;
using namespace mlir::tai;

static void registerDialects(DialectRegistry &registry) {
  registerUpstreamDialects(registry);
  registerAll(registry);
}

void mlir::tai::registerModuleFileTranslations() {
  static TranslateFromMLIRRegistration write(
      "tai-to-bytecode",
      "bytecode with its checksum, which taiKernelLoad takes",
      [](Operation *op, raw_ostream &output) -> LogicalResult {
        auto module = dyn_cast<ModuleOp>(op);
        if (!module)
          return op->emitError("expected a module");
        return writeModule(module, output);
      },
      registerDialects);
  static TranslateToMLIRRegistration read(
      "tai-from-bytecode", "the module in bytecode with its checksum",
      [](const std::shared_ptr<llvm::SourceMgr> &sources,
         MLIRContext *context) -> OwningOpRef<Operation *> {
        const llvm::MemoryBuffer *file =
            sources->getMemoryBuffer(sources->getMainFileID());
        return readModule(file->getBuffer(), ParserConfig(context),
                          file->getBufferIdentifier());
      },
      registerDialects);
}
