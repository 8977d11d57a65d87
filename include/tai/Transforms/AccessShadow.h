//===- AccessShadow.h - What checked kernels keep of accesses ---*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The memory that `tai-instrument-accesses` makes kernels use: what the runtime
// that launches them must agree on. No MLIR needed for the constants.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_ACCESSSHADOW_H
#define TAI_TRANSFORMS_ACCESSSHADOW_H

#include "mlir/IR/BuiltinOps.h"
#include "tai/ABI/AccessLog.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

using namespace runtime::accesslog;

/// The fields for which a checked kernel takes a shadow array, in the order of
/// its arguments.
SmallVector<FieldOp> getShadowedFields(ModuleOp module);

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_ACCESSSHADOW_H
