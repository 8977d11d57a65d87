//===- IndexMath.h - Index arithmetic that folds ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Emits arithmetic on `index` and folds constants, so that no clean-up pass is
// needed after the lowering; sets the overflow flags by which LLVM recognises
// affine addresses.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_INDEXMATH_H
#define TAI_TRANSFORMS_UTILS_INDEXMATH_H

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/IR/Builders.h"

namespace mlir::tai {

class IndexMath {
public:
  IndexMath(OpBuilder &builder, Location loc) : builder(builder), loc(loc) {}

  Value constant(int64_t value) {
    return arith::ConstantIndexOp::create(builder, loc, value);
  }

  /// Emits a + b for numbers whose sum is known to be in range.
  Value add(Value a, Value b) {
    std::optional<int64_t> x = getConstantIntValue(a);
    std::optional<int64_t> y = getConstantIntValue(b);
    if (x && y)
      return constant(*x + *y);
    if (x && *x == 0)
      return b;
    if (y && *y == 0)
      return a;
    return arith::AddIOp::create(builder, loc, a, b, nsw());
  }

  Value sub(Value a, Value b) {
    std::optional<int64_t> x = getConstantIntValue(a);
    std::optional<int64_t> y = getConstantIntValue(b);
    if (x && y)
      return constant(*x - *y);
    if (y && *y == 0)
      return a;
    return arith::SubIOp::create(builder, loc, a, b, nsw());
  }
  Value sub(Value a, int64_t b) { return b ? sub(a, constant(b)) : a; }

  Value mul(Value a, Value b) {
    std::optional<int64_t> x = getConstantIntValue(a);
    std::optional<int64_t> y = getConstantIntValue(b);
    if (x && y)
      return constant(*x * *y);
    if (x && *x == 1)
      return b;
    if (y && *y == 1)
      return a;
    return arith::MulIOp::create(builder, loc, a, b, nsw());
  }
  Value mul(Value a, int64_t b) { return b == 1 ? a : mul(a, constant(b)); }

  /// Emits a / b or a % b for numbers that are not negative.
  Value div(Value a, Value b) {
    std::optional<int64_t> x = getConstantIntValue(a);
    std::optional<int64_t> y = getConstantIntValue(b);
    if (x && y && *y != 0)
      return constant(*x / *y);
    if (y && *y == 1)
      return a;
    return arith::DivUIOp::create(builder, loc, a, b);
  }
  Value div(Value a, int64_t b) { return b == 1 ? a : div(a, constant(b)); }

  Value rem(Value a, Value b) {
    std::optional<int64_t> x = getConstantIntValue(a);
    std::optional<int64_t> y = getConstantIntValue(b);
    if (x && y && *y != 0)
      return constant(*x % *y);
    if (y && *y == 1)
      return constant(0);
    return arith::RemUIOp::create(builder, loc, a, b);
  }
  Value rem(Value a, int64_t b) { return rem(a, constant(b)); }

  Value min(Value a, Value b) {
    std::optional<int64_t> x = getConstantIntValue(a);
    std::optional<int64_t> y = getConstantIntValue(b);
    if (x && y)
      return constant(std::min(*x, *y));
    return arith::MinSIOp::create(builder, loc, a, b);
  }
  Value max(Value a, Value b) {
    std::optional<int64_t> x = getConstantIntValue(a);
    std::optional<int64_t> y = getConstantIntValue(b);
    if (x && y)
      return constant(std::max(*x, *y));
    return arith::MaxSIOp::create(builder, loc, a, b);
  }

  /// Emits the number of steps of one from `lower` to `upper`, never negative.
  Value extent(Value lower, Value upper) {
    return max(sub(upper, lower), constant(0));
  }

  Value toI64(Value index) { return cast(builder.getI64Type(), index); }
  Value toIndex(Value integer) { return cast(builder.getIndexType(), integer); }

private:
  Value cast(Type type, Value value) {
    if (value.getType() == type)
      return value;
    if (std::optional<int64_t> c = getConstantIntValue(value))
      return arith::ConstantOp::create(builder, loc,
                                       builder.getIntegerAttr(type, *c));
    return arith::IndexCastOp::create(builder, loc, type, value);
  }
  static arith::IntegerOverflowFlags nsw() {
    return arith::IntegerOverflowFlags::nsw;
  }

  OpBuilder &builder;
  Location loc;
};

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_INDEXMATH_H
