//===- Guards.h - Marks of the guards of derivatives ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_GUARDS_H
#define TAI_DIALECT_TAI_IR_GUARDS_H

#include "llvm/ADT/StringRef.h"

namespace mlir::tai {

/// Marks a select that gives zero where an adjoint is zero, and otherwise the
/// product of the adjoint and a partial derivative that may be infinite or NaN.
/// The select is not a branch of the program: its own derivative is zero only
/// where both the tested adjoint and the derivative of that adjoint are zero.
constexpr llvm::StringLiteral kGuard = "tai.guard";

/// Marks a select that gives zero where an adjoint is infinite and the partial
/// derivative zero, and otherwise the product of both.
constexpr llvm::StringLiteral kInfiniteGuard = "tai.guard_infinite";

/// Marks the reverse of a branch: the results of the op are adjoints, and
/// values computed from the results are guarded.
constexpr llvm::StringLiteral kAdjointBranch = "tai.adjoint_branch";

} // namespace mlir::tai

#endif // TAI_DIALECT_TAI_IR_GUARDS_H
