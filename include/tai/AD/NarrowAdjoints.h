//===- NarrowAdjoints.h - Adjoints of numbers of 16 bits --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The adjoint of a value of 16 bits has its type, but is not rounded to it on
// its way: what stood before the cast is used where that is wanted.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_NARROWADJOINTS_H
#define TAI_AD_NARROWADJOINTS_H

#include "mlir/Dialect/Arith/IR/Arith.h"

namespace mlir::tai {

/// What an adjoint of 16 bits was rounded from, or the adjoint itself.
inline Value getWidened(Value adjoint) {
  auto narrowed = adjoint.getDefiningOp<arith::TruncFOp>();
  Type type = getElementTypeOrSelf(adjoint.getType());
  return narrowed && type.getIntOrFloatBitWidth() == 16 ? narrowed.getIn()
                                                        : adjoint;
}

} // namespace mlir::tai

#endif // TAI_AD_NARROWADJOINTS_H
