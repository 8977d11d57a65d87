//===- ShadowOps.h - Operations that have shadows ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What `tai-shadow-execution` knows of the operations of the LLVM dialect.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TOLLVM_SHADOWOPS_H
#define TAI_LIB_CONVERSION_TOLLVM_SHADOWOPS_H

#include "mlir/IR/Operation.h"

namespace mlir::tai {

/// What an operation does, as users say it.
std::string nameOperation(Operation *op);

/// The function of libm for a wider type, or "".
std::string nameWiderCall(StringRef name, Type type, Type shadow);

/// Rounds at the most; is as right as its operands.
bool onlyRounds(Operation *op);

/// Computes nothing.
bool onlyMoves(Operation *op);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TOLLVM_SHADOWOPS_H
