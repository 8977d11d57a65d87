//===- Vectorization.h - Limits of LLVM's vectorisation ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_VECTORIZATION_H
#define TAI_TRANSFORMS_UTILS_VECTORIZATION_H

#include "mlir/IR/Block.h"

namespace mlir::tai {

/// True if LLVM may run the iterations of the innermost loop around the block
/// side by side in the lanes of vectors.
bool mayBeVectorized(Block &block);

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_VECTORIZATION_H
