//===- AccessShadow.h - Shadow memory of checked kernels --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The layout of the shadow memory that `tai-instrument-accesses` adds to
// kernels, shared with the runtime through tai/ABI/AccessLog.h.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_ACCESSLOG_ACCESSSHADOW_H
#define TAI_TRANSFORMS_ACCESSLOG_ACCESSSHADOW_H

#include "mlir/IR/BuiltinOps.h"
#include "tai/ABI/AccessLog.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

using namespace runtime::accesslog;

/// The fields for which a checked kernel has a shadow array argument, in the
/// order of the arguments.
SmallVector<FieldOp> getShadowedFields(ModuleOp module);

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_ACCESSLOG_ACCESSSHADOW_H
