//===- Recursion.h - Functions that call themselves -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_FOREIGN_RECURSION_H
#define TAI_LIB_AD_FOREIGN_RECURSION_H

#include "mlir/Dialect/Func/IR/FuncOps.h"

namespace mlir::tai {

/// Makes loops of the call that `function` makes of itself, if there is one.
/// The body must be one block. Fails with a diagnostic at the call.
LogicalResult unrollRecursion(func::FuncOp function);

} // namespace mlir::tai

#endif // TAI_LIB_AD_FOREIGN_RECURSION_H
