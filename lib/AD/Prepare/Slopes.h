//===- Slopes.h - Derivatives inside a kernel -------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_PREPARE_SLOPES_H
#define TAI_LIB_AD_PREPARE_SLOPES_H

#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/Interfaces/FunctionInterfaces.h"

namespace mlir::tai {

/// Emits at the insertion point the partial derivatives of `values`, numbers
/// defined before it, with respect to the components `positions` (row-major) of
/// the vector `source`: result[k][i] is that of `values[i]` by component
/// `positions[k]`, null for zero. The emitted code is constant to
/// differentiation. Fails if values depend on the source through memory, or
/// through an op without a tangent.
FailureOr<SmallVector<SmallVector<Value>>>
createSlopes(ImplicitLocOpBuilder &builder, FunctionOpInterface function,
             Value source, ArrayRef<int64_t> positions, ValueRange values);

} // namespace mlir::tai

#endif // TAI_LIB_AD_PREPARE_SLOPES_H
