//===- Slopes.h - Derivatives of some values by others ----------*- C++ -*-===//
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

/// Computes at the insertion point the derivatives of `values`, numbers that
/// are made before it, by the components of the vector `source` at each of
/// `positions` (row-major): result[k][i] is that of `values[i]` by the k-th
/// one, null for zero. Nothing of it is differentiated in turn. Fails if values
/// depend on the source through memory, or through what has no tangent.
FailureOr<SmallVector<SmallVector<Value>>>
createSlopes(ImplicitLocOpBuilder &builder, FunctionOpInterface function,
             Value source, ArrayRef<int64_t> positions, ValueRange values);

} // namespace mlir::tai

#endif // TAI_LIB_AD_PREPARE_SLOPES_H
