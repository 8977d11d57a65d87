//===- FloatOptions.h - How exact float arithmetic is -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TOLLVM_FLOATOPTIONS_H
#define TAI_LIB_CONVERSION_TOLLVM_FLOATOPTIONS_H

#include "mlir/IR/Operation.h"
#include "mlir/IR/PatternMatch.h"

namespace mlir {
class LLVMTypeConverter;
} // namespace mlir

namespace mlir::tai {

/// Adds float options to all arithmetic below `root` that does not carry them
/// yet.
void setFloatOptions(Operation *root, bool fastMath, bool contract);

/// Adds the expansions of operations for which upstream has none, or a wrong
/// one.
void populateExpansionFixes(RewritePatternSet &patterns);

/// Adds casts of floats to integers that yield one number, whatever the float.
void populateFloatCasts(const LLVMTypeConverter &converter,
                        RewritePatternSet &patterns);

/// Adds expansions of the exponential, the logarithm and the hyperbolic tangent
/// of f32 to arithmetic in f64, which vectorises.
void populateWideMath(RewritePatternSet &patterns, PatternBenefit benefit);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TOLLVM_FLOATOPTIONS_H
