//===- ZeroTests.h - Choices by a test for zero -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_ZEROTESTS_H
#define TAI_ANALYSIS_ZEROTESTS_H

#include "mlir/Dialect/Arith/IR/Arith.h"

namespace mlir::tai {

/// Marks a branch whose then arm is the else arm without guards, for inputs
/// that need none. Without the mark, both arms count as code of their own.
constexpr llvm::StringLiteral kGuardVersions = "tai.guard_versions";

/// The value that the condition of `select` compares with zero; null if the
/// condition is no comparison with zero.
Value getTestedForZero(arith::SelectOp select);

/// The adjoint, tangent or partial derivative whose zeros a guard tests for;
/// null if the guard tests another value.
Value getGuarded(arith::SelectOp guard);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_ZEROTESTS_H
