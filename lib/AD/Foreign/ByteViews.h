//===- ByteViews.h - Arrays in memory of bytes ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_FOREIGN_BYTEVIEWS_H
#define TAI_LIB_AD_FOREIGN_BYTEVIEWS_H

#include "mlir/Dialect/Func/IR/FuncOps.h"

namespace mlir::tai {

/// Replaces arrays that `function` places in bytes which it allocates
/// ('memref.view') by arrays of their own. Fails, with a diagnostic, for other
/// views of bytes, and for different arrays in the same bytes.
LogicalResult splitByteViews(func::FuncOp function);

} // namespace mlir::tai

#endif // TAI_LIB_AD_FOREIGN_BYTEVIEWS_H
