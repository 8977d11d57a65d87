//===- MatrixFormulas.h - Formulas of matrix decompositions -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An operator notation for formulas on the entries of small matrices, and
// declarations for the derivative of a singular value decomposition.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_RULES_MATRIXFORMULAS_H
#define TAI_AD_RULES_MATRIXFORMULAS_H

#include "tai/AD/Rules/MatrixHelpers.h"

namespace mlir::tai {

/// A scalar in a formula, with operators that emit ops.
struct S {
  DerivativeBuilder *b;
  Value v;
};
inline S operator+(S a, S c) {
  return {a.b, arith::AddFOp::create(*a.b, a.v, c.v)};
}
inline S operator-(S a, S c) {
  return {a.b, arith::SubFOp::create(*a.b, a.v, c.v)};
}
inline S operator*(S a, S c) {
  return {a.b, arith::MulFOp::create(*a.b, a.v, c.v)};
}
inline S operator/(S a, S c) {
  return {a.b, arith::DivFOp::create(*a.b, a.v, c.v)};
}
inline S operator-(S a) { return {a.b, arith::NegFOp::create(*a.b, a.v)}; }
inline S operator*(double a, S c) {
  return S{c.b, c.b->createConstant(c.v.getType(), a)} * c;
}
inline S abs(S a) { return {a.b, math::AbsFOp::create(*a.b, a.v)}; }
/// Returns the larger of `a` and `c`, and `c` if either is NaN: a single
/// instruction on most targets.
inline S max(S a, S c) {
  Value isLarger =
      arith::CmpFOp::create(*a.b, arith::CmpFPredicate::OGT, a.v, c.v);
  return {a.b, arith::SelectOp::create(*a.b, isLarger, a.v, c.v)};
}

/// Returns `value`, or 0 where |a| <= `floor`. Where `a` is NaN, returns
/// `value`.
inline S keepAbove(S a, S floor, S value) {
  DerivativeBuilder &b = *a.b;
  Value isSmall =
      arith::CmpFOp::create(b, arith::CmpFPredicate::OLE, abs(a).v, floor.v);
  return {&b, arith::SelectOp::create(
                  b, isSmall, b.createZero(value.v.getType()), value.v)};
}

/// Returns a / c, or 0 where |c| <= `floor`.
inline S divideAbove(S a, S c, S floor) { return keepAbove(c, floor, a / c); }

/// Returns `a`, or 0 where |a| <= `floor`.
inline S dropBelow(S a, S floor) { return keepAbove(a, floor, a); }

/// A small matrix in a formula, with access to its entries.
struct M {
  DerivativeBuilder *b;
  Value v;
  S operator()(int64_t i, int64_t j) const {
    return {b, b->createExtract(v, i * getRows(v) + j)};
  }
};

/// The greatest magnitude of an entry of the matrix.
inline S getGreatest(M m) {
  int64_t n = getRows(m.v);
  S greatest = abs(m(0, 0));
  for (int64_t k = 1; k != n * n; ++k)
    greatest = max(greatest, abs(m(k / n, k % n)));
  return greatest;
}

inline double getEpsilon(Type type) {
  return getElementTypeOrSelf(type).isF64() ? 2.220446e-16 : 1.192093e-7;
}

/// The relative distance above which two singular values count as distinct.
inline double getTolerance(Type type) { return 8 * getEpsilon(type); }

/// The sum of two singular values, relative to the greatest, above which the
/// polar rotation counts as differentiable: where the sum is zero, the rotation
/// jumps, and the rounding error in place of that zero must not be divided by.
inline double getJumpTolerance(Type type) { return 1024 * getEpsilon(type); }

/// The magnitude up to which a divisor counts as zero, whatever the matrix is.
inline double getLeast(Type type) {
  return getElementTypeOrSelf(type).isF64() ? 1e-300 : 1e-37;
}

/// The thresholds of the two divisors (difference and sum of singular values)
/// in the derivative of a decomposition.
struct Floors {
  S difference, sum;
};
inline Floors getFloors(M sigma) {
  Type type = sigma.v.getType();
  S greatest = abs(sigma(0, 0));
  S least{sigma.b,
          sigma.b->createConstant(greatest.v.getType(), getLeast(type))};
  return {getTolerance(type) * greatest + least,
          getJumpTolerance(type) * greatest + least};
}

/// The differentials of the factors of A = U Σ Vᵀ: dU = U (E + O), dV = V (E -
/// O), with skew-symmetric E (`even`) and O (`odd`); `rest` is the remainder of
/// Uᵀ dA V, whose diagonal is dΣ.
struct FactorRotations {
  Value even, odd, rest;
};
FactorRotations createFactorRotations(TangentBuilder &b, SvdOp svd);

/// The tangent of a product of matrices that contains two factors of one
/// decomposition, as in U M Uᵀ or U M Vᵀ; null if `product` does not. The
/// common rotation E of U and V is cancelled analytically, not by subtracting
/// rounded products.
Value createFactorProductTangent(TangentBuilder &b, MatmulOp product);

} // namespace mlir::tai

#endif // TAI_AD_RULES_MATRIXFORMULAS_H
