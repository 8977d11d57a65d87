//===- Conventions.h - Subgradients chosen at kinks -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A kernel or function may choose other subgradients at some kinks, by the
// attribute `tai.conventions`, a dictionary:
//
//   ties = "split"   both operands of a max or min that tie get half
//   arcs = "clamp"   the derivatives of asin and acos at ±1 are those of the
//                    next number inside
//   guards = false   a zero adjoint is multiplied like any other, to measure
//                    the cost of testing for it
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_CONVENTIONS_H
#define TAI_AD_CONVENTIONS_H

#include "mlir/IR/Operation.h"

namespace mlir::tai {

struct Conventions {
  bool splitTies = false;
  bool clampArcs = false;
  bool guards = true;

  /// The derivative conventions of the kernel or function that `op` is, or is
  /// in.
  static Conventions of(Operation *op);
  /// Emits an error and fails if the attribute `tai.conventions` does not have
  /// the form above.
  static LogicalResult verify(Operation *function);
};

} // namespace mlir::tai

#endif // TAI_AD_CONVENTIONS_H
