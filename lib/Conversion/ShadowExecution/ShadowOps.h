//===- ShadowOps.h - Operations in shadow execution -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Properties of LLVM dialect operations for `tai-shadow-execution`.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_SHADOWEXECUTION_SHADOWOPS_H
#define TAI_LIB_CONVERSION_SHADOWEXECUTION_SHADOWOPS_H

#include "mlir/IR/ImplicitLocOpBuilder.h"

namespace mlir::tai {

/// The name of an operation for users, as in a report.
std::string nameOperation(Operation *op);

/// Returns the libm function that computes `name` for the wider type of
/// shadows, or "".
std::string nameWiderCall(StringRef name, Type type, Type shadow);

/// True for an operation whose only error is the rounding of its result: it is
/// well conditioned.
bool onlyRounds(Operation *op);

/// True for an operation that copies values without computing.
bool onlyMoves(Operation *op);

/// Emits a vector of the shape of `like` with `value` in each lane; `value`
/// itself if `like` is not a vector.
Value emitSplat(ImplicitLocOpBuilder &b, Value value, Type like);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_SHADOWEXECUTION_SHADOWOPS_H
