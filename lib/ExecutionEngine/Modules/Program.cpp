//===- Program.cpp - A whole file in a session ----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Modules/Program.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/Verifier.h"
#include "mlir/Pass/PassManager.h"
#include "tai/ExecutionEngine/Modules/ModuleFile.h"
#include "tai/ExecutionEngine/Modules/SavedProgram.h"
#include "tai/Transforms/Passes.h"
#include "llvm/ADT/SetVector.h"

using namespace mlir;
using namespace mlir::tai;

OwningOpRef<ModuleOp> Program::read(Session &session, StringRef bytes,
                                    StringRef file) {
  DiagnosticCollector collector(session.getContext());
  ParserConfig config(session.getContext(), /*verifyAfterParse=*/false);
  OwningOpRef<ModuleOp> module = readModule(bytes, config, file);
  if (!module)
    (void)session.fail(
        collector.take(FailureKind::Syntax, "the file does not parse"));
  return module;
}

/// Rejects ops that the program could not refer to, such as nested modules.
static LogicalResult checkFlat(ModuleOp file) {
  for (ModuleOp nested : file.getOps<ModuleOp>())
    return nested.emitError("a program is one module, and names nothing of a "
                            "module inside of it; move these ops out");
  return success();
}

/// Makes a module with one kernel, and the functions, kernels and global arrays
/// that it refers to.
static OwningOpRef<ModuleOp> extract(ModuleOp file, KernelOp kernel) {
  llvm::SetVector<Operation *> needed;
  needed.insert(kernel);
  for (size_t i = 0; i < needed.size(); ++i) {
    needed[i]->walk([&](Operation *op) {
      op->getAttrDictionary().walk([&](SymbolRefAttr symbol) {
        Operation *named = file.lookupSymbol(symbol.getRootReference());
        if (isa_and_nonnull<KernelOp, func::FuncOp, memref::GlobalOp>(named))
          needed.insert(named);
      });
    });
  }
  OwningOpRef<ModuleOp> module = ModuleOp::create(kernel.getLoc());
  for (Operation *op : needed)
    module->push_back(op->clone());
  return module;
}

LogicalResult Program::declare() {
  SmallVector<std::string> trees;
  auto declareAll = [&]() -> LogicalResult {
    for (TreeOp tree : file->getOps<TreeOp>()) {
      if (failed(session.addTree(tree)))
        return failure();
      trees.push_back(tree.getSymName().str());
    }
    for (FieldOp field : file->getOps<FieldOp>())
      if (failed(session.addField(field)))
        return failure();
    for (KernelOp kernel : file->getOps<KernelOp>()) {
      FailureOr<SessionKernel *> made =
          session.createKernel(extract(*file, kernel), kernel.getSymName());
      if (failed(made))
        return failure();
      kernels[kernel.getSymName()] = *made;
    }
    return success();
  };
  if (succeeded(declareAll()))
    return success();
  Failure reason = session.getFailure();
  for (auto &kernel : kernels)
    session.destroyKernel(kernel.second);
  kernels.clear();
  // Destroying a tree destroys its fields.
  for (const std::string &tree : trees)
    (void)session.destroyTree(tree);
  return session.fail(std::move(reason));
}

FailureOr<std::unique_ptr<Program>> Program::load(Session &session,
                                                  OwningOpRef<ModuleOp> file) {
  {
    DiagnosticCollector collector(session.getContext());
    if (failed(checkSaved(*file)) || failed(checkFlat(*file)) ||
        failed(verify(*file)))
      return session.fail(
          collector.take(FailureKind::Type, "the file does not verify"));
  }
  if (failed(session.fuseLaunchesIn(*file)))
    return failure();
  std::unique_ptr<Program> program(new Program(session, std::move(file)));
  if (failed(program->declare()))
    return failure();
  return program;
}

Program::~Program() {
  for (auto &function : functions)
    session.unload(function.second);
  for (auto &kernel : kernels)
    session.destroyKernel(kernel.second);
}

LogicalResult Program::checkFunction(StringRef name) {
  auto function = file->lookupSymbol<func::FuncOp>(name);
  if (!function) {
    std::string hint =
        findKernel(name) ? "; it is a kernel, which is launched" : "";
    return session.fail(FailureKind::Usage,
                        "the file holds no 'func.func @" + name + "'" + hint);
  }
  DiagnosticCollector collector(session.getContext());
  if (function.getNumArguments() || function.getNumResults())
    function.emitError("@")
        << name << " takes no arguments and returns nothing";
  else if (function.isExternal())
    function.emitError("@") << name << " is declared, and has no body to run";
  else
    return success();
  return session.fail(collector.take(FailureKind::Type));
}

LogicalResult Program::run(StringRef name) {
  if (failed(checkFunction(name)))
    return failure();
  auto known = functions.find(name);
  // A function is compiled again if the options have changed since it was
  // compiled.
  if (known != functions.end() && !session.isCurrent(known->second)) {
    session.unload(known->second);
    functions.erase(known);
    known = functions.end();
  }
  if (known == functions.end()) {
    FailureOr<Session::HostFunction> made = session.compileHost(*file, name);
    if (failed(made))
      return failure();
    known = functions.try_emplace(name, std::move(*made)).first;
  }
  return session.runHost(known->second, [this](StringRef kernelName) {
    return findKernel(kernelName);
  });
}
