//===- SelectedFunctionsPass.h - Run on selected functions ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The base of the passes of `tai-autodiff`: they run on the functions selected
// for differentiation, and use op interfaces implemented by external models.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_SELECTEDFUNCTIONSPASS_H
#define TAI_LIB_AD_SELECTEDFUNCTIONSPASS_H

#include "mlir/IR/DialectRegistry.h"
#include "tai/AD/Prepare/Selection.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Interfaces/Differentiable.h"

namespace mlir::tai {

/// Base of passes with the option `kernel`, which define `LogicalResult
/// runOnFunction(FunctionOpInterface)` and optionally `begin`, called before
/// the first function, and `end`. On a module it runs on the functions that are
/// to be differentiated, which depends on the other functions there. A pass
/// that is not declared for modules alone also runs on a single function, and
/// then reads nothing else but trees and fields.
template <typename Pass, template <typename> class GeneratedBase>
struct SelectedFunctionsPass : GeneratedBase<Pass> {
  using Generated = GeneratedBase<Pass>;
  using Generated::Generated;

  void getDependentDialects(DialectRegistry &registry) const override {
    Generated::getDependentDialects(registry);
    registerDifferentiableModels(registry);
  }

  void runOnOperation() override {
    auto *self = static_cast<Pass *>(this);
    FailureOr<SmallVector<FunctionOpInterface>> functions = select();
    if (failed(functions) || failed(self->begin()))
      return this->signalPassFailure();
    bool isGood = true;
    // The pass goes on after a failure, so that the errors of all functions are
    // reported.
    for (FunctionOpInterface function : *functions)
      isGood &= succeeded(self->runOnFunction(function));
    self->end();
    if (!isGood)
      this->signalPassFailure();
  }

  FailureOr<SmallVector<FunctionOpInterface>> select() {
    Operation *root = this->getOperation();
    if (auto module = dyn_cast<ModuleOp>(root))
      return selectFunctions(module, this->kernels);
    auto function = dyn_cast<FunctionOpInterface>(root);
    bool isWanted = function && !function.isExternal() && belongsToTai(root) &&
                    (this->kernels.empty() ||
                     llvm::is_contained(this->kernels, function.getName()));
    return SmallVector<FunctionOpInterface>(isWanted ? 1 : 0, function);
  }

  LogicalResult begin() { return success(); }
  void end() {}
};

} // namespace mlir::tai

#endif // TAI_LIB_AD_SELECTEDFUNCTIONSPASS_H
