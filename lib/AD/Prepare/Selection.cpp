//===- Selection.cpp - Functions to differentiate -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Prepare/Selection.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "tai/AD/Foreign/Foreign.h"
#include "tai/AD/Signature.h"
#include "tai/Analysis/HelpfulPasses.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

static constexpr StringLiteral kDifferentiate = "tai.differentiate";

static bool hasAdjointAlready(FunctionOpInterface function) {
  return function->hasAttr("adjoint") || function->hasAttr("tai.adjoint") ||
         isSplit(function);
}

/// Refuses to launch a kernel under a tape if it is differentiated by arguments
/// or results: a launch has no memory for their adjoints.
static LogicalResult checkTaped(LaunchOp launch, ModuleOp module) {
  auto kernel = module.lookupSymbol<KernelOp>(launch.getKernel());
  if (!kernel || !kernel.getGradientsAttr())
    return success();
  InFlightDiagnostic diag =
      launch.emitError()
      << "a host program cannot launch '@" << kernel.getName()
      << "' under a tape: it has no memory for the adjoints of arguments and "
         "results";
  diag.attachNote(kernel.getLoc())
      << "differentiated by arguments or results here; use fields instead";
  return diag;
}

/// Returns the kernels that are launched under a tape, or nullopt if the module
/// has no tape.
static FailureOr<std::optional<DenseSet<StringAttr>>>
collectTaped(ModuleOp module) {
  DenseSet<StringAttr> kernels;
  SmallVector<Operation *> pending;
  module.walk([&](Operation *op) {
    if (op->hasTrait<RecordsLaunches>())
      pending.push_back(op);
  });
  if (pending.empty())
    return std::optional<DenseSet<StringAttr>>();
  DenseSet<Operation *> visited;
  bool isGood = true;
  while (!pending.empty())
    pending.pop_back_val()->walk([&](Operation *op) {
      if (auto launch = dyn_cast<LaunchOp>(op)) {
        kernels.insert(launch.getKernelAttr().getAttr());
        isGood &= succeeded(checkTaped(launch, module));
      } else if (auto call = dyn_cast<func::CallOp>(op)) {
        auto callee = module.lookupSymbol<func::FuncOp>(call.getCallee());
        if (callee && visited.insert(callee).second)
          pending.push_back(callee);
      }
    });
  if (!isGood)
    return failure();
  return std::optional(kernels);
}

LogicalResult mlir::tai::checkNested(ModuleOp module) {
  WalkResult result = module.walk([&](FunctionOpInterface function) {
    if (!function->hasAttr(kDifferentiate) || hasAdjointAlready(function) ||
        function->hasAttr(getFunctionAttrName(function, "tangent")) ||
        SymbolTable::getNearestSymbolTable(function->getParentOp()) == module)
      return WalkResult::advance();
    InFlightDiagnostic diag = function.emitError("cannot differentiate '@")
                              << function.getName()
                              << "': it stands in a nested module";
    diag.attachNote(function->getParentOp()->getLoc())
        << "run the pass on this module: builtin.module(builtin.module(...))";
    return WalkResult::interrupt();
  });
  return failure(result.wasInterrupted());
}

LogicalResult mlir::tai::checkIsFunction(FunctionOpInterface function) {
  if (isa<func::FuncOp, KernelOp>(function.getOperation())) {
    if (!function.isExternal())
      return success();
    return function.emitError("cannot differentiate '@")
           << function.getName() << "', which has no body here";
  }
  return function.emitError("cannot differentiate a '")
         << function->getName() << "'; expects a 'func.func' or a 'tai.kernel'";
}

LogicalResult mlir::tai::checkHasOneBlock(FunctionOpInterface function) {
  if (function.getFunctionBody().hasOneBlock())
    return success();
  InFlightDiagnostic diag = function.emitError(
      "cannot differentiate a function of several blocks; structured control "
      "flow is expected");
  attachHelpfulPass(diag, function.getFunctionBody().front().getTerminator());
  return diag;
}

void mlir::tai::takePrepared(ModuleOp module,
                             SmallVectorImpl<FunctionOpInterface> &functions) {
  DenseMap<StringAttr, FunctionOpInterface> prepared;
  for (auto function : module.getOps<func::FuncOp>())
    if (auto name = function->getAttrOfType<FlatSymbolRefAttr>(kPreparedFor))
      prepared[name.getAttr()] = function;
  if (prepared.empty())
    return;
  llvm::SetVector<FunctionOpInterface> all;
  for (FunctionOpInterface function : functions) {
    FunctionOpInterface copy = prepared.lookup(function.getNameAttr());
    all.insert(copy ? copy : function);
  }
  functions.assign(all.begin(), all.end());
}

static FailureOr<SmallVector<FunctionOpInterface>>
selectWhole(ModuleOp module, ArrayRef<std::string> names) {
  SmallVector<FunctionOpInterface> functions;
  if (!names.empty()) {
    for (const std::string &name : names) {
      auto function = module.lookupSymbol<FunctionOpInterface>(name);
      if (!function)
        return module.emitError() << "there is no kernel or function '@" << name
                                  << "' to differentiate";
      if (!hasAdjointAlready(function))
        functions.push_back(function);
    }
    takePrepared(module, functions);
    return functions;
  }
  // Adjoints are not differentiated.
  DenseSet<StringAttr> adjoints;
  for (auto kernel : module.getOps<KernelOp>())
    if (FlatSymbolRefAttr adjoint = kernel.getAdjointAttr())
      adjoints.insert(adjoint.getAttr());
  FailureOr<std::optional<DenseSet<StringAttr>>> launched =
      collectTaped(module);
  if (failed(launched))
    return failure();
  const std::optional<DenseSet<StringAttr>> &taped = *launched;
  for (auto function : module.getOps<FunctionOpInterface>()) {
    if (function.isExternal() || hasAdjointAlready(function))
      continue;
    bool isWanted = isa<KernelOp>(function.getOperation())
                        ? !taped || taped->contains(function.getNameAttr())
                        : function->hasAttr(kDifferentiate);
    if (isWanted && !adjoints.contains(function.getNameAttr()))
      functions.push_back(function);
  }
  takePrepared(module, functions);
  return functions;
}

FailureOr<SmallVector<FunctionOpInterface>>
mlir::tai::selectFunctions(ModuleOp module, ArrayRef<std::string> names) {
  auto selected = selectWhole(module, names);
  if (failed(selected))
    return selected;
  llvm::MapVector<StringAttr, SmallVector<FunctionOpInterface>> parts;
  for (auto kernel : module.getOps<KernelOp>())
    if (FlatSymbolRefAttr whole = kernel.getPartOfAttr())
      parts[whole.getAttr()].push_back(kernel);
  if (parts.empty())
    return selected;
  llvm::SetVector<FunctionOpInterface> functions;
  for (FunctionOpInterface function : *selected) {
    auto *it = parts.find(function.getNameAttr());
    if (it == parts.end())
      functions.insert(function);
    else
      for (FunctionOpInterface part : it->second)
        if (!hasAdjointAlready(part))
          functions.insert(part);
  }
  return SmallVector<FunctionOpInterface>(functions.getArrayRef());
}

bool mlir::tai::mayHaveAdjoint(FunctionOpInterface function, Storage storage) {
  if (storage.memref)
    return isa<BlockArgument>(storage.memref);
  return static_cast<bool>(
      lookupField(function, storage.field).getAdjointAttr());
}
