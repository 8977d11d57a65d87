//===- CheckedKernels.cpp - Kernels that check accesses -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Makes the instrumented variant of a kernel for a tape that checks accesses.
//
//===----------------------------------------------------------------------===//

#include "mlir/Pass/PassManager.h"
#include "mlir/Transforms/Passes.h"
#include "tai/Analysis/KernelAccesses.h"
#include "tai/CodeGen/Diagnostics.h"
#include "tai/CodeGen/InjectedFailures.h"
#include "tai/ExecutionEngine/Kernels/KernelCode.h"
#include "tai/ExecutionEngine/Kernels/Summaries.h"
#include "tai/ExecutionEngine/Reproduce/Reproducer.h"
#include "tai/Runtime/Launch/AccessChecks.h"
#include "tai/Support/Places.h"
#include "tai/Transforms/AccessLog/AccessShadow.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Utils/Canonicalization.h"

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

runtime::Status KernelCode::makeChecked(runtime::CheckedKernel &checked) {
  OwningOpRef<ModuleOp> module = source.module->clone();
  for (FieldOp field : getShadowedFields(*module))
    if (runtime::FieldPtr known = source.fields.lookup(field.getName()))
      checked.fields.push_back(known);
  if (checked.fields.empty())
    return runtime::Status::success();
  Failure failure;
  auto populate = [](OpPassManager &manager) {
    manager.addPass(createInlinerPass({}, [](OpPassManager &) {}));
    manager.addPass(
        createCanonicalizerPass(GreedyRewriteConfig(), getBrokenPatterns()));
    manager.addPass(createInstrumentAccesses());
    injectFailingPass(manager, "checks");
  };
  if (mlir::failed(runPasses(*module, populate,
                             "checking the accesses of '" + getName() + "'",
                             FailureKind::Type, failure)))
    return services.failures.keep(std::move(failure));
  auto kernel = module->lookupSymbol<KernelOp>(getName());
  auto described = cast<ArrayAttr>(kernel.removeCheckedAccessesAttr());
  for (auto access : described.getAsRange<ArrayAttr>()) {
    runtime::CheckedAccess row;
    row.field =
        source.fields.lookup(cast<FlatSymbolRefAttr>(access[0]).getValue())
            .get();
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
  // The checked variant is compiled for the CPU, whose order the listed
  // accesses have, even if the kernel itself runs on another device.
  CompileOptions options = getOptions();
  options.device = std::nullopt;
  options.deviceTarget.clear();
  options.interpret = false;
  auto compiled = services.compiler.compile(
      {*module, getName(), CompileRequest::Goal::Primal}, options, failure);
  if (!compiled)
    return services.failures.keep(std::move(failure));
  keepFunction(*compiled);
  runtime::KernelInfo info;
  info.name = getName();
  info.argSlots = countSlots(kernel.getArgumentTypes());
  info.resultSlots = countSlots(kernel.getResultTypes());
  info.trees = findTrees(compiled->trees);
  info.summary = summarize(services.rt, *source.module, getKernel());
  info.function = reinterpret_cast<TaiKernelFn>(compiled->address);
  checked.kernel = services.rt.launcher().kernels().create(std::move(info));
  return runtime::Status::success();
}
