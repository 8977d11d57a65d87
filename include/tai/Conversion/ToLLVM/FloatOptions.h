//===- FloatOptions.h - Float semantics of lowered code ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CONVERSION_TOLLVM_FLOATOPTIONS_H
#define TAI_CONVERSION_TOLLVM_FLOATOPTIONS_H

#include "mlir/IR/Operation.h"
#include "mlir/IR/PatternMatch.h"

namespace mlir {
class LLVMTypeConverter;
} // namespace mlir

namespace mlir::tai {

/// Sets fast-math flags on all arithmetic below `root` that has no flags yet.
void setFloatOptions(Operation *root, bool fastMath, bool contract);

/// Adds the patterns shared by hosts and devices: upstream's conversions of
/// control flow and arithmetic, expansions of operations for which upstream has
/// no expansion or a wrong one, and float-to-integer casts that are defined for
/// every float.
void populateSharedToLLVM(const LLVMTypeConverter &converter,
                          RewritePatternSet &patterns);

/// Adds expansions of the exponential, the logarithm and the hyperbolic tangent
/// of f32 to arithmetic in f64, which vectorises.
void populateWideMath(RewritePatternSet &patterns, PatternBenefit benefit);

/// Adds expansions of elementary functions with errors of at most one unit in
/// the last place, in functions of kernels that are `accurate`. Devices have no
/// floats wider than f64.
void populateAccurateMath(RewritePatternSet &patterns, PatternBenefit benefit,
                          bool onDevice = false);

/// Makes the functions in module `root` that belong to kernels with `ftz` flush
/// denormals to zero, by setting the processor's control word on entry and
/// restoring it on exit. Fails after an error if the processor has no such
/// mode.
LogicalResult flushDenormals(Operation *root);

} // namespace mlir::tai

#endif // TAI_CONVERSION_TOLLVM_FLOATOPTIONS_H
