//===- DeviceFloats.h - Floats as a GPU does not have them ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TONVVM_DEVICEFLOATS_H
#define TAI_LIB_CONVERSION_TONVVM_DEVICEFLOATS_H

#include "mlir/Dialect/LLVMIR/LLVMDialect.h"

namespace mlir {
class RewritePatternSet;
} // namespace mlir

namespace mlir::tai {

/// Adds patterns for approximate functions of f32 where the instructions of a
/// GPU are wrong for some arguments: sine and cosine far from zero, powers of
/// numbers that are not positive, quotients with divisors above 2^126.
void populateFastDeviceMath(RewritePatternSet &patterns, unsigned benefit);

/// Makes a function of a GPU flush denormals to zero: f32 by an attribute that
/// selects flushing instructions; f64, for which there are none, and results of
/// the math library by comparisons.
void flushOnDevice(LLVM::LLVMFuncOp function);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TONVVM_DEVICEFLOATS_H
