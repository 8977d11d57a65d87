//===- ZeroAdjoints.h - Zero-adjoint skipping -------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_ZEROADJOINTS_H
#define TAI_ANALYSIS_ZEROADJOINTS_H

#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// Tells when a loop of an adjoint over a sparse field can be skipped: in a
/// cell in which all of `sources` are zero. With no sources, it cannot be
/// skipped.
struct LoopFlags {
  std::string field;
  std::vector<std::string> sources;
  /// True if the loop adds to elements that are not below a sparse level.
  bool sumsUp = false;
};

/// True if a result of an op without regions is zero where the operands with
/// `isZero` are zero. In a product, one zero factor is enough: guards make a
/// zero adjoint contribute zero, whatever the partial derivative is.
bool isZeroOfZeros(OpResult result, llvm::function_ref<bool(Value)> isZero);

/// Finds the loops of an adjoint over sparse fields that can be skipped in
/// cells; see docs/decisions/0007-adjoint-flags.md.
std::vector<LoopFlags> findLoopFlags(KernelOp primal, KernelOp adjoint);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_ZEROADJOINTS_H
