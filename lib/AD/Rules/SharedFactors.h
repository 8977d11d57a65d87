//===- SharedFactors.h - Factors that operands share ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The quotient (s u) / (s v) does not depend on s. By the quotient rule, the
// adjoint of s gets g / (s v) from the numerator and its negative from the
// denominator: they cancel, but overflow where s v is denormal. So the common
// factor is removed from both operands, and u / v is differentiated. The same
// holds for atan2.
//
// In forward mode a common factor is removed from sums, too: s u - s v has the
// tangent of s times (u - v), also where the tangent of s is infinite.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_RULES_SHAREDFACTORS_H
#define TAI_LIB_AD_RULES_SHAREDFACTORS_H

#include "tai/AD/Forward/TangentBuilder.h"

namespace mlir::tai {

/// A common factor of both operands of an op, and the cofactor of each; null
/// stands for the constant 1.
struct SharedFactor {
  Value factor;
  Value rest[2];
};

/// Finds the common factor of both operands of an op whose result depends on
/// the quotient of its operands alone.
std::optional<SharedFactor> findFactorOfRatio(Operation *op);

/// Sets the tangent of a sum or difference with a common factor whose tangent
/// may be infinite. False if `op` has no such factor, or if a cofactor has a
/// tangent.
bool extendSharedSum(Operation *op, TangentBuilder &b);

} // namespace mlir::tai

#endif // TAI_LIB_AD_RULES_SHAREDFACTORS_H
