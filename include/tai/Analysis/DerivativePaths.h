//===- DerivativePaths.h - Where derivatives may pass -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// One answer to "does a derivative pass here", for both modes: it does wherever
// a value is made from one that has a derivative, of whatever type and by
// whatever op, unless the op is known to be discrete. Where there is no rule,
// differentiation fails; nothing is taken to be constant because it is not
// understood.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_DERIVATIVEPATHS_H
#define TAI_ANALYSIS_DERIVATIVEPATHS_H

#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Interfaces/Differentiable.h"

namespace mlir::tai {

/// True if the results of the op change by jumps only, or do not depend on what
/// its operands hold: comparisons, conversions to integers, sizes.
bool isDiscrete(Operation *op);

/// True if a derivative may pass from the operand to the results of its op:
/// what the rule of the op says; without one, unless the op is discrete.
bool carriesDerivative(OpOperand &operand);

/// What is differentiated, as far as paths depend on it.
struct DerivativeEnds {
  /// Whether a storage has an adjoint, or holds tangents.
  llvm::function_ref<bool(Storage)> hasDerivative;
  /// Values that have a derivative of their own.
  ArrayRef<Value> inputs = {}, outputs = {};
  /// Whether derivatives are carried forward.
  bool isForward = false;
};

/// Reports each op without a rule on a path from what has a derivative to where
/// a derivative is wanted, each access that such a path would take through
/// memory that is not followed, and each place where what has a derivative is
/// stored as something else.
LogicalResult verifyDerivativePaths(
    FunctionOpInterface function, const DerivativeEnds &ends,
    llvm::function_ref<InFlightDiagnostic(Operation *, const Twine &)>
        emitError);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_DERIVATIVEPATHS_H
