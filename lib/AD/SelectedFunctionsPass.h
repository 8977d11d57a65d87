//===- SelectedFunctionsPass.h - Passes on what has a gradient --*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What the passes of `tai-autodiff` share: they run on the functions that are
// to be differentiated, and ask their ops by interfaces that models implement.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_SELECTEDFUNCTIONSPASS_H
#define TAI_LIB_AD_SELECTEDFUNCTIONSPASS_H

#include "mlir/IR/DialectRegistry.h"
#include "tai/AD/Selection.h"
#include "tai/Interfaces/Differentiable.h"

namespace mlir::tai {

/// A pass with the option `kernel`, which defines
/// `LogicalResult runOnFunction(FunctionOpInterface)`, and `begin` where
/// something is to be done before the first. The passes are on modules: others
/// of their functions say what is selected.
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
    FailureOr<SmallVector<FunctionOpInterface>> functions =
        selectFunctions(this->getOperation(), this->kernels);
    if (failed(functions) || failed(self->begin()))
      return this->signalPassFailure();
    bool isGood = true;
    // One error does not hide the next: every function is tried.
    for (FunctionOpInterface function : *functions)
      isGood &= succeeded(self->runOnFunction(function));
    if (!isGood)
      this->signalPassFailure();
  }

  LogicalResult begin() { return success(); }
};

} // namespace mlir::tai

#endif // TAI_LIB_AD_SELECTEDFUNCTIONSPASS_H
