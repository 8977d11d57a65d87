//===- WidenArithmetic.h - Arithmetic wider than storage --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_WIDENARITHMETIC_H
#define TAI_TRANSFORMS_WIDENARITHMETIC_H

#include <memory>

namespace mlir {
class Pass;
} // namespace mlir

namespace mlir::tai {

/// All float arithmetic of a kernel with `precision` in its modes takes place
/// in that precision, or in a wider type where it does so already. What is
/// loaded is widened at once, and what is stored is rounded once; casts to
/// narrower types round, as the program says. It stands before
/// differentiation: adjoints compute as widely.
std::unique_ptr<Pass> createWidenArithmetic();

/// Makes `tai-widen-arithmetic` known to pass pipelines given as text.
void registerWidenArithmetic();

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_WIDENARITHMETIC_H
