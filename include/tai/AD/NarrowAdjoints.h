//===- NarrowAdjoints.h - Adjoints of narrow floats -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The adjoint of a narrow float has the same narrow type, but is not rounded at
// each step where a wider type computes it: rules that can use the wider value
// look through the cast.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_NARROWADJOINTS_H
#define TAI_AD_NARROWADJOINTS_H

#include "mlir/Dialect/Arith/IR/Arith.h"

namespace mlir::tai {

/// The wider value that an adjoint was truncated from, or the adjoint itself.
inline Value getWidened(Value adjoint) {
  auto narrowed = adjoint.getDefiningOp<arith::TruncFOp>();
  return narrowed ? narrowed.getIn() : adjoint;
}

/// Casts an adjoint to another float type, rounding at most once even if the
/// adjoint was itself truncated from a wider value.
inline Value createCastOfAdjoint(OpBuilder &builder, Location loc,
                                 Value adjoint, Type type) {
  if (adjoint.getType() == type)
    return adjoint;
  Value wide = getWidened(adjoint);
  auto getWidth = [](Type of) {
    return getElementTypeOrSelf(of).getIntOrFloatBitWidth();
  };
  if (wide.getType() == type)
    return wide;
  if (getWidth(wide.getType()) < getWidth(type))
    return arith::ExtFOp::create(builder, loc, type, wide);
  return arith::TruncFOp::create(builder, loc, type, wide);
}

} // namespace mlir::tai

#endif // TAI_AD_NARROWADJOINTS_H
