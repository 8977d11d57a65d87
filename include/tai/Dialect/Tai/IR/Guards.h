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

/// Marks a select of zero where an adjoint is zero, and else of its product
/// with a partial derivative that may not be finite. It is not a branch of the
/// program: to differentiate it again, both the adjoint that it tests and that
/// one's own derivative must be zero for the result to be.
constexpr llvm::StringLiteral kGuard = "tai.guard";

/// Marks a select of zero where an infinite adjoint meets a partial derivative
/// of zero, and else of their product.
constexpr llvm::StringLiteral kInfiniteGuard = "tai.guard_infinite";

} // namespace mlir::tai

#endif // TAI_DIALECT_TAI_IR_GUARDS_H
