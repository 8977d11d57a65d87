//===- SharedFactors.h - Factors that operands share ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A quotient of s u and s v does not depend on s. By the rule of the quotient,
// s gets g / (s v) from above and as much less from below: two numbers that
// cancel, and that are beyond the range of floats where s v is denormal. So
// what the operands share is taken from both, and u / v is differentiated. The
// arc tangent of a quotient is of that kind, too.
//
// In forward mode the same holds of sums: the tangent of s u - s v is that of s
// times u - v, also where it is infinite.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_RULES_SHAREDFACTORS_H
#define TAI_LIB_AD_RULES_SHAREDFACTORS_H

#include "tai/AD/TangentBuilder.h"

namespace mlir::tai {

/// A factor of both operands of an op, and what is left of each without it:
/// null for one.
struct SharedFactor {
  Value factor;
  Value rest[2];
};

/// That of an op that depends on the quotient of its two operands alone.
std::optional<SharedFactor> findFactorOfRatio(Operation *op);

/// The tangent of a sum or difference that shares a factor whose tangent may be
/// infinite. False if it is not one, or if more than the factor has a tangent.
bool extendSharedSum(Operation *op, TangentBuilder &b);

} // namespace mlir::tai

#endif // TAI_LIB_AD_RULES_SHAREDFACTORS_H
