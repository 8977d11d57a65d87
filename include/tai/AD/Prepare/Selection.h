//===- Selection.h - Functions to differentiate -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_PREPARE_SELECTION_H
#define TAI_AD_PREPARE_SELECTION_H

#include "mlir/IR/BuiltinOps.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Interfaces/Differentiable.h"

namespace mlir::tai {

/// The kernels and functions of `module` that are to be differentiated and have
/// no adjoint yet, in the order of the module. With `names`: the kernels and
/// functions of these names, which must exist. Without names: the kernels
/// launched under a tape (all, if there is no tape) and the functions with the
/// attribute `tai.differentiate`. A kernel that was split is replaced by its
/// parts.
FailureOr<SmallVector<FunctionOpInterface>>
selectFunctions(ModuleOp module, ArrayRef<std::string> names);

/// Reports an error at a function in a nested module that requests a gradient:
/// no pass makes it.
LogicalResult checkNested(ModuleOp module);

/// Reports an error if `function` has several blocks.
LogicalResult checkHasOneBlock(FunctionOpInterface function);

/// Reports an error if `function` is of a kind that is not differentiated, or
/// has no body.
LogicalResult checkIsFunction(FunctionOpInterface function);

/// True if `storage`, a field or an array argument, may have an adjoint.
bool mayHaveAdjoint(FunctionOpInterface function, Storage storage);

/// Replaces each function that has a prepared copy, made for differentiation,
/// by the copy.
void takePrepared(ModuleOp module,
                  SmallVectorImpl<FunctionOpInterface> &functions);

} // namespace mlir::tai

#endif // TAI_AD_PREPARE_SELECTION_H
