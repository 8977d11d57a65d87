//===- VectorSymbols.h - Symbols of functions of vectors --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_MATH_VECTORSYMBOLS_H
#define TAI_RUNTIME_MATH_VECTORSYMBOLS_H

#include <utility>
#include <vector>

namespace mlir::tai::runtime {

/// The runtime's own functions in VectorMath.def, with their names. The target
/// processor of code determines the functions that the code may call.
std::vector<std::pair<const char *, void *>> vectorMathSymbols();

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_MATH_VECTORSYMBOLS_H
