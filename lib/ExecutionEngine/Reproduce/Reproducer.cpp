//===- Reproducer.cpp - Reproducers of internal errors --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Reproduce/Reproducer.h"
#include "mlir/IR/Verifier.h"
#include "mlir/Pass/Pass.h"
#include "tai/ExecutionEngine/Reproduce/StripAttributes.h"
#include "llvm/ADT/StringMap.h"
#include "llvm/Support/FileSystem.h"
#include "llvm/Support/xxhash.h"
#include <mutex>

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Passes
//===----------------------------------------------------------------------===//

void InvalidAfterPass::runAfterPassFailed(Pass *pass, Operation *op) {
  // The passes that contain the failing pass fail after it, and are not noted.
  if (!finding.pass.empty())
    return;
  finding.pass =
      (pass->getArgument().empty() ? pass->getName() : pass->getArgument())
          .str();
  DiagnosticCollector collector(op->getContext());
  if (failed(verify(op)))
    finding.error = collector.take(FailureKind::Internal).message;
}

/// True for an error that is about the compiler, not the program: from the
/// verifier after a pass, or from a conversion that did not lower an op.
static bool isOurs(const InvalidAfterPass::Finding &finding,
                   StringRef message) {
  // The error is compared with the verifier's message, since a pass may also
  // leave an invalid module after an error in the program.
  return (!finding.error.empty() && finding.error == message) ||
         finding.pass == "tai-verify-llvm" ||
         message.starts_with("failed to legalize");
}

LogicalResult mlir::tai::runPipeline(PassManager &manager,
                                     InvalidAfterPass::Finding &finding,
                                     ModuleOp module, const Twine &title,
                                     FailureKind kind, Failure &failure) {
  finding = {};
  DiagnosticCollector collector(module.getContext());
  if (succeeded(manager.run(module)))
    return success();
  if (!collector.hasErrors()) {
    failure = Failure::get(FailureKind::Internal,
                           title + " failed inside the compiler, in '" +
                               finding.pass + "'");
    return mlir::failure();
  }
  failure = collector.take(kind);
  if (!isOurs(finding, failure.message))
    return mlir::failure();
  failure.kind = FailureKind::Internal;
  failure.message = (title + " failed inside the compiler: in or after '" +
                     finding.pass + "': " + failure.message)
                        .str();
  return mlir::failure();
}

//===----------------------------------------------------------------------===//
// Files
//===----------------------------------------------------------------------===//

/// Prints the lines of a failure as comments.
static void printComments(llvm::raw_ostream &stream, const Failure &failure,
                          StringRef mark) {
  SmallVector<StringRef> lines;
  StringRef(failure.message).split(lines, '\n');
  for (StringRef line : lines)
    stream << mark << ' ' << line << '\n';
}

static std::string getText(const Failure &failure, ModuleOp module,
                           PassManager &manager, StringRef next) {
  std::string text, pipeline;
  llvm::raw_string_ostream stream(text), pipelineStream(pipeline);
  printComments(stream, failure, "//");
  stream << "// tai-opt --run-reproducer <this file>";
  if (!next.empty())
    stream << " | " << next;
  stream << '\n';
  module.print(stream, OpPrintingFlags().enableDebugInfo());
  manager.printAsTextualPipeline(pipelineStream);
  stream << "\n{-#\n  external_resources: {\n    mlir_reproducer: {\n"
         << "      pipeline: \"";
  stream.write_escaped(pipeline);
  stream << "\",\n      disable_threading: true,\n"
         << "      verify_each: true\n    }\n  }\n#-}\n";
  return text;
}

/// Returns the path of a file with the text, which a process writes only once:
/// a launch that fails is often repeated. The order of pipelines nested on
/// several kinds of functions is unspecified, so only the module distinguishes
/// files.
static std::string writeOnce(StringRef text, StringRef suffix) {
  static std::mutex mutex;
  static llvm::StringMap<std::string> written;
  std::lock_guard<std::mutex> lock(mutex);
  std::string &path =
      written[std::to_string(llvm::xxh3_64bits(text.rsplit("\n{-#").first))];
  if (!path.empty() && llvm::sys::fs::exists(path))
    return path;
  SmallString<128> made;
  int descriptor;
  path.clear();
  if (llvm::sys::fs::createTemporaryFile("tai-reproducer", suffix, descriptor,
                                         made))
    return path;
  llvm::raw_fd_ostream stream(descriptor, /*shouldClose=*/true);
  stream << text;
  stream.close();
  if (stream.has_error()) {
    stream.clear_error();
    llvm::sys::fs::remove(made);
    return path;
  }
  return path = made.str().str();
}

constexpr StringLiteral kMark("; reproducer: ");

static void addFile(Failure &failure, StringRef text, StringRef suffix) {
  std::string path = writeOnce(text, suffix);
  if (path.empty())
    path = "none, for the folder of temporary files cannot be written";
  failure.message += (kMark + path).str();
  failure.text += "error: " + failure.message + "\n";
}

void mlir::tai::addReproducer(Failure &failure, ModuleOp module,
                              PassManager &manager, StringRef next) {
  if (!StringRef(failure.message).contains(kMark))
    addFile(failure, getText(failure, module, manager, next), "mlir");
}

void mlir::tai::addReproducer(Failure &failure, StringRef module,
                              StringRef command) {
  std::string text;
  llvm::raw_string_ostream stream(text);
  printComments(stream, failure, ";");
  stream << "; " << command << '\n' << module;
  addFile(failure, text, "ll");
}

LogicalResult
mlir::tai::runPasses(ModuleOp module,
                     llvm::function_ref<void(OpPassManager &)> populate,
                     const Twine &title, FailureKind kind, Failure &failure) {
  PassManager manager(module.getContext());
  InvalidAfterPass::Finding finding;
  manager.addInstrumentation(std::make_unique<InvalidAfterPass>(finding));
  StripAttributes::addIfWanted(manager);
  populate(manager);
  OwningOpRef<ModuleOp> given = module.clone();
  if (succeeded(runPipeline(manager, finding, module, title, kind, failure)))
    return success();
  if (failure.kind == FailureKind::Internal)
    addReproducer(failure, *given, manager);
  return mlir::failure();
}
