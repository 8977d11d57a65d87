//===- MatrixHelpers.h - Formulas on small matrices -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_RULES_MATRIXHELPERS_H
#define TAI_AD_RULES_MATRIXHELPERS_H

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "tai/AD/Forward/TangentBuilder.h"
#include "tai/AD/Reverse/AdjointBuilder.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

inline int64_t getRows(Value matrix) {
  return cast<VectorType>(matrix.getType()).getDimSize(0);
}

inline Value createTranspose(DerivativeBuilder &b, Value matrix) {
  auto type = cast<VectorType>(matrix.getType());
  auto result = VectorType::get({type.getDimSize(1), type.getDimSize(0)},
                                type.getElementType());
  return TransposeOp::create(b, result, matrix);
}

inline Value createMatmul(DerivativeBuilder &b, Value lhs, Value rhs) {
  auto left = cast<VectorType>(lhs.getType());
  auto right = cast<VectorType>(rhs.getType());
  SmallVector<int64_t> shape = {left.getDimSize(0)};
  if (right.getRank() == 2)
    shape.push_back(right.getDimSize(1));
  return MatmulOp::create(b, VectorType::get(shape, left.getElementType()), lhs,
                          rhs);
}

inline Value createOuter(DerivativeBuilder &b, Value lhs, Value rhs) {
  auto left = cast<VectorType>(lhs.getType());
  auto right = cast<VectorType>(rhs.getType());
  return OuterOp::create(
      b,
      VectorType::get({left.getDimSize(0), right.getDimSize(0)},
                      left.getElementType()),
      lhs, rhs);
}

/// vector * scalar
inline Value createScaled(DerivativeBuilder &b, Value vector, Value scalar) {
  Value factor = vector::BroadcastOp::create(b, vector.getType(), scalar);
  return arith::MulFOp::create(b, vector, factor);
}

/// Emits `value`, or zero where the whole of `adjoint` is zero: each component
/// of `value` can depend on all components of `adjoint`.
inline Value createMatrixGuard(DerivativeBuilder &b, Value adjoint,
                               Value value) {
  Value any = adjoint;
  if (isa<VectorType>(adjoint.getType())) // a sum of squares could underflow
    any = SumOp::create(b, getElementTypeOrSelf(adjoint.getType()),
                        math::AbsFOp::create(b, adjoint));
  return b.createGuard(any, value);
}

/// Guards `value`, a product of `adjoint` and the primal value `factor`, if
/// `factor` may be infinite or NaN.
inline Value guardFor(DerivativeBuilder &b, Value factor, Value adjoint,
                      Value value) {
  return b.getFacts().mayBeNonFinite(factor)
             ? createMatrixGuard(b, adjoint, value)
             : value;
}

/// Emits the component-wise sum of two terms of a tangent; a null term is zero.
inline Value addTerms(DerivativeBuilder &b, Value lhs, Value rhs) {
  if (!lhs || !rhs)
    return lhs ? lhs : rhs;
  return arith::AddFOp::create(b, lhs, rhs);
}

/// Emits the tangent of a bilinear op: lhs' * rhs + lhs * rhs'. `multiply`
/// builds the op. Where a tangent may be infinite or NaN, its product with a
/// zero of the other operand must be zero; the op is then built by `expand`,
/// component by component from products of scalars.
Value createBilinearTangent(
    TangentBuilder &b, Value lhs, Value rhs,
    llvm::function_ref<Value(Value lhs, Value rhs)> multiply,
    llvm::function_ref<
        Value(llvm::function_ref<Value(int64_t lhs, int64_t rhs)> term)>
        expand);

} // namespace mlir::tai

#endif // TAI_AD_RULES_MATRIXHELPERS_H
