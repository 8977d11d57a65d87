//===- NarrowAdjoints.h - Adjoints of 16-bit floats -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The adjoint of a 16-bit float has the same type, but is not rounded at each
// step: rules that can use it look through the cast to the wider value.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_NARROWADJOINTS_H
#define TAI_AD_NARROWADJOINTS_H

#include "mlir/Dialect/Arith/IR/Arith.h"

namespace mlir::tai {

/// The wider value that a 16-bit adjoint was truncated from, or the adjoint
/// itself.
inline Value getWidened(Value adjoint) {
  auto narrowed = adjoint.getDefiningOp<arith::TruncFOp>();
  Type type = getElementTypeOrSelf(adjoint.getType());
  return narrowed && type.getIntOrFloatBitWidth() == 16 ? narrowed.getIn()
                                                        : adjoint;
}

} // namespace mlir::tai

#endif // TAI_AD_NARROWADJOINTS_H
