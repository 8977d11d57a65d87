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

/// Adds what hosts and devices share: upstream's conversions of control flow
/// and arithmetic, the expansions of operations for which upstream has none, or
/// a wrong one, and casts of floats to integers that yield one number, whatever
/// the float.
void populateSharedToLLVM(const LLVMTypeConverter &converter,
                          RewritePatternSet &patterns);

/// Adds expansions of the exponential, the logarithm and the hyperbolic tangent
/// of f32 to arithmetic in f64, which vectorises.
void populateWideMath(RewritePatternSet &patterns, PatternBenefit benefit);

/// Adds expansions of elementary functions that keep them within one unit in
/// the last place, in functions of kernels that are `accurate`. Devices have no
/// floats wider than f64.
void populateAccurateMath(RewritePatternSet &patterns, PatternBenefit benefit,
                          bool onDevice = false);

/// Lets the functions of the module `root` treat denormal numbers as zero, by
/// the control word of the processor, which they put back: those of kernels
/// with `ftz`. Fails after an error where the processor has no such thing.
LogicalResult flushDenormals(Operation *root);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TOLLVM_FLOATOPTIONS_H
