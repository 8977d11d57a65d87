//===- WidenArithmetic.h - Arithmetic wider than storage --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_SIMPLIFY_WIDENARITHMETIC_H
#define TAI_TRANSFORMS_SIMPLIFY_WIDENARITHMETIC_H

#include <memory>

namespace mlir {
class Pass;
} // namespace mlir

namespace mlir::tai {

/// Creates the pass that widens all float arithmetic of a kernel with
/// `precision` in its modes to that precision; wider types are kept. Loaded
/// values are widened at once, and stored values are rounded once; explicit
/// casts to narrower types still round. The pass runs before differentiation,
/// so that adjoints use the same precision.
std::unique_ptr<Pass> createWidenArithmetic();

/// Registers `tai-widen-arithmetic` by name.
void registerWidenArithmetic();

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_SIMPLIFY_WIDENARITHMETIC_H
