//===- Plugins.cpp - Dialects and passes of others in a session -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Session/Plugins.h"
#include "mlir/Pass/PassManager.h"
#include "mlir/Pass/PassRegistry.h"
#include "mlir/Tools/Plugins/DialectPlugin.h"
#include "mlir/Tools/Plugins/PassPlugin.h"
#include "mlir/Transforms/Passes.h"
#include "tai/ExecutionEngine/Modules/ModuleFile.h"
#include "tai/ExecutionEngine/Session/Session.h"
#include "tai/InitAll.h"
#include <mutex>

using namespace mlir;
using namespace mlir::tai;

LogicalResult mlir::tai::loadPlugin(Session &session, StringRef file) {
#ifdef TAI_PORTABLE
  return session.fail(FailureKind::Usage,
                      "cannot load '" + file +
                          "': this libtai holds LLVM and MLIR itself, and a "
                          "plugin brings others; use an installation beside "
                          "LLVM's packages");
#else
  if (session.countObjects().kernels != 0)
    return session.fail(FailureKind::Usage,
                        "cannot load '" + file +
                            "': plugins are loaded before the first kernel");
  auto dialects = DialectPlugin::load(file.str());
  auto passes = PassPlugin::load(file.str());
  std::string reasons;
  if (!dialects)
    reasons = llvm::toString(dialects.takeError());
  if (!passes)
    // One of the two errors is kept, since both have the same text if there is
    // no such file.
    reasons = llvm::toString(passes.takeError());
  if (!dialects && !passes)
    return session.fail(FailureKind::Usage, "cannot load '" + file +
                                                "' as a plugin of dialects or "
                                                "of passes: " +
                                                reasons);
  if ((dialects && dialects->getPluginName() == "tai") ||
      (passes && passes->getPluginName() == "tai"))
    return session.fail(FailureKind::Usage,
                        "'" + file +
                            "' is tai's own plugin, for other programs; this "
                            "one has its dialects and passes already");
  if (dialects) {
    DialectRegistry registry;
    dialects->registerDialectRegistryCallbacks(registry);
    session.getContext()->appendDialectRegistry(registry);
    session.getContext()->loadAllAvailableDialects();
  }
  if (passes)
    passes->registerPassRegistryCallbacks();
  return success();
#endif
}

LogicalResult mlir::tai::runPasses(Session &session, ModuleOp module,
                                   StringRef pipeline) {
  static std::once_flag once;
  std::call_once(once, [] {
    registerAllPasses();
    registerTransformsPasses();
  });
  MLIRContext *context = session.getContext();
  DiagnosticCollector collector(context);
  // Text that nests too deeply is rejected, because it would overflow the stack
  // of MLIR's parser.
  if (!checkText(pipeline, context, "pipeline"))
    return session.fail(collector.take(FailureKind::Syntax));
  std::string text = pipeline.trim().str();
  if (!StringRef(text).starts_with("builtin.module(") &&
      !StringRef(text).starts_with("any("))
    text = "builtin.module(" + text + ")";
  std::string reasons;
  llvm::raw_string_ostream stream(reasons);
  FailureOr<OpPassManager> parsed = parsePassPipeline(text, stream);
  if (failed(parsed))
    return session.fail(FailureKind::Syntax, "the pipeline does not parse: " +
                                                 StringRef(reasons).trim());
  PassManager manager(context, parsed->getOpAnchorName());
  static_cast<OpPassManager &>(manager) = std::move(*parsed);
  if (succeeded(manager.run(module)))
    return success();
  return session.fail(
      collector.take(FailureKind::Type, "a pass of '" + text + "' has failed"));
}
