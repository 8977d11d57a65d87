//===- SessionChecks.cpp - Kernels that watch their accesses --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Makes the form of a kernel that a checking tape launches in its place, and
// that whose indices are clamped.
//
//===----------------------------------------------------------------------===//

#include "../CodeGen/InjectedFailures.h"
#include "Reproducer.h"
#include "mlir/Pass/PassManager.h"
#include "mlir/Transforms/Passes.h"
#include "tai/CodeGen/Diagnostics.h"
#include "tai/ExecutionEngine/Session.h"
#include "tai/Runtime/Launch/AccessChecks.h"
#include "tai/Transforms/AccessShadow.h"
#include "tai/Transforms/Passes.h"

using namespace mlir;
using namespace mlir::tai;

static runtime::AccessKind getRuntimeKind(FieldUse use) {
  switch (use) {
  case FieldUse::Read:
    return runtime::AccessKind::Read;
  case FieldUse::Write:
    return runtime::AccessKind::Write;
  case FieldUse::Accumulate:
    return runtime::AccessKind::Accumulate;
  }
  llvm_unreachable("unknown use");
}

/// With bounds="clamp" a kernel is another program, of which all is made that
/// is made of kernels: adjoints, summaries, keys.
LogicalResult Session::clampIndices(ModuleOp module) {
  if (options.bounds != BoundsMode::Clamp || options.debug)
    return success();
  auto populate = [](OpPassManager &manager) {
    manager.addPass(createInlinerPass({}, [](OpPassManager &) {}));
    manager.addPass(createCheckBounds({BoundsMode::Clamp}));
    injectFailingPass(manager, "clamp");
  };
  Failure failure;
  if (succeeded(runPasses(module, populate, "clamping indices",
                          FailureKind::Type, failure)))
    return success();
  return fail(std::move(failure));
}

runtime::Status Session::compileChecked(KernelCode &code,
                                        runtime::CheckedKernel &checked) {
  OwningOpRef<ModuleOp> module = code.module->clone();
  for (FieldOp field : getShadowedFields(*module))
    if (runtime::FieldPtr known = code.fields.lookup(field.getName()))
      checked.fields.push_back(known);
  if (checked.fields.empty())
    return runtime::Status::success();
  Failure failure;
  auto populate = [](OpPassManager &manager) {
    manager.addPass(createInlinerPass({}, [](OpPassManager &) {}));
    manager.addPass(createCanonicalizerPass());
    manager.addPass(createInstrumentAccesses());
    injectFailingPass(manager, "checks");
  };
  if (mlir::failed(runPasses(*module, populate,
                             "checking the accesses of '" + code.name + "'",
                             FailureKind::Type, failure)))
    return keepFailure(std::move(failure));
  auto kernel = module->lookupSymbol<KernelOp>(code.name);
  auto described =
      cast<ArrayAttr>(kernel->removeAttr(kCheckedAccessesAttrName));
  for (auto access : described.getAsRange<ArrayAttr>()) {
    runtime::CheckedAccess row;
    row.field =
        code.fields.lookup(cast<FlatSymbolRefAttr>(access[0]).getValue()).get();
    row.kind = getRuntimeKind(
        static_cast<FieldUse>(cast<IntegerAttr>(access[1]).getInt()));
    if (FileLineColLoc place =
            findFileLocation(Location(cast<LocationAttr>(access[2])))) {
      row.file = place.getFilename().str();
      row.line = place.getLine();
      row.column = place.getColumn();
    }
    checked.accesses.push_back(std::move(row));
  }
  // Who touches what is written down in the order of the CPU, wherever the
  // kernel itself runs.
  CompileOptions options = code.options;
  options.device = std::nullopt;
  options.deviceTarget.clear();
  options.interpret = false;
  auto compiled = compiler->compile(
      {*module, code.name, CompileRequest::Goal::Primal}, options, failure);
  if (!compiled)
    return keepFailure(std::move(failure));
  {
    std::lock_guard<std::mutex> lock(mutex);
    code.functions.push_back(*compiled);
  }
  runtime::KernelInfo info;
  info.name = code.name;
  info.argSlots = countSlots(kernel.getArgumentTypes());
  info.resultSlots = countSlots(kernel.getResultTypes());
  for (const std::string &name : compiled->trees)
    info.trees.push_back(*llvm::find_if(
        code.trees, [&](const auto &tree) { return tree->name() == name; }));
  info.summary =
      summarize(*code.module, code.module->lookupSymbol<KernelOp>(code.name));
  info.function = reinterpret_cast<TaiKernelFn>(compiled->address);
  checked.kernel = rt->createKernel(std::move(info));
  return runtime::Status::success();
}
