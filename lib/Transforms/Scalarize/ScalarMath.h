//===- ScalarMath.h - Scalar arithmetic builder -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Short methods to emit the formulas of small matrices.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_SCALARIZE_SCALARMATH_H
#define TAI_LIB_TRANSFORMS_SCALARIZE_SCALARMATH_H

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/IR/Builders.h"

namespace mlir::tai {

/// The components of a vector or matrix, row-major.
using Components = SmallVector<Value>;

class ScalarMath {
public:
  ScalarMath(OpBuilder &builder, Location loc) : builder(builder), loc(loc) {}

  Value add(Value a, Value b) {
    if (isFloat(a))
      return arith::AddFOp::create(builder, loc, a, b);
    return arith::AddIOp::create(builder, loc, a, b);
  }
  Value sub(Value a, Value b) {
    if (isFloat(a))
      return arith::SubFOp::create(builder, loc, a, b);
    return arith::SubIOp::create(builder, loc, a, b);
  }
  Value mul(Value a, Value b) {
    if (isFloat(a))
      return arith::MulFOp::create(builder, loc, a, b);
    return arith::MulIOp::create(builder, loc, a, b);
  }
  Value div(Value a, Value b) {
    return arith::DivFOp::create(builder, loc, a, b);
  }
  Value neg(Value a) { return arith::NegFOp::create(builder, loc, a); }
  Value abs(Value a) { return math::AbsFOp::create(builder, loc, a); }
  Value sqrt(Value a) { return math::SqrtOp::create(builder, loc, a); }
  Value max(Value a, Value b) {
    return arith::MaximumFOp::create(builder, loc, a, b);
  }

  Value constant(Type type, double value) {
    if (auto floatType = dyn_cast<FloatType>(type))
      return arith::ConstantOp::create(builder, loc,
                                       builder.getFloatAttr(floatType, value));
    return arith::ConstantOp::create(
        builder, loc, builder.getIntegerAttr(type, int64_t(value)));
  }
  /// Emit ordered comparisons, which are false if an operand is NaN.
  Value less(Value a, Value b) {
    return arith::CmpFOp::create(builder, loc, arith::CmpFPredicate::OLT, a, b);
  }
  Value lessOrEqual(Value a, Value b) {
    return arith::CmpFOp::create(builder, loc, arith::CmpFPredicate::OLE, a, b);
  }
  Value equal(Value a, Value b) {
    return arith::CmpFOp::create(builder, loc, arith::CmpFPredicate::OEQ, a, b);
  }
  Value select(Value condition, Value a, Value b) {
    return arith::SelectOp::create(builder, loc, condition, a, b);
  }

  /// Σ aᵢ bᵢ.
  Value dot(ArrayRef<Value> a, ArrayRef<Value> b) {
    Value sum = mul(a[0], b[0]);
    for (size_t i = 1; i != a.size(); ++i)
      sum = add(sum, mul(a[i], b[i]));
    return sum;
  }
  Components cross(ArrayRef<Value> a, ArrayRef<Value> b) {
    Components result;
    for (unsigned i = 0; i != 3; ++i) {
      unsigned j = (i + 1) % 3, k = (i + 2) % 3;
      result.push_back(sub(mul(a[j], b[k]), mul(a[k], b[j])));
    }
    return result;
  }

  /// Emits the product of a matrix of n rows and k columns and a matrix of k
  /// rows and m columns.
  Components product(ArrayRef<Value> a, ArrayRef<Value> b, unsigned n,
                     unsigned k, unsigned m) {
    Components result;
    for (unsigned i = 0; i != n; ++i)
      for (unsigned j = 0; j != m; ++j) {
        Value sum;
        for (unsigned l = 0; l != k; ++l) {
          Value term = mul(a[i * k + l], b[l * m + j]);
          sum = sum ? add(sum, term) : term;
        }
        result.push_back(sum);
      }
    return result;
  }
  /// Returns the transpose of a matrix of n rows and m columns.
  static Components transpose(ArrayRef<Value> a, unsigned n, unsigned m) {
    Components result;
    for (unsigned j = 0; j != m; ++j)
      for (unsigned i = 0; i != n; ++i)
        result.push_back(a[i * m + j]);
    return result;
  }

  OpBuilder &getBuilder() { return builder; }
  Location getLoc() { return loc; }

private:
  static bool isFloat(Value value) { return isa<FloatType>(value.getType()); }

  OpBuilder &builder;
  Location loc;
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_SCALARIZE_SCALARMATH_H
