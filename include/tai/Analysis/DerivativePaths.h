//===- DerivativePaths.h - Paths of derivatives -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Whether a derivative passes through an operand, in forward and in reverse
// mode: true for values of every type and for every op, unless the op is known
// to be discrete. Where an op on a path of derivatives has no rule,
// differentiation fails; no value is assumed to be constant because its op is
// not understood.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_DERIVATIVEPATHS_H
#define TAI_ANALYSIS_DERIVATIVEPATHS_H

#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Interfaces/Differentiable.h"

namespace mlir::tai {

/// True if the results of the op are piecewise constant in its operands, or do
/// not depend on their contents: comparisons, conversions to integers, sizes.
bool isDiscrete(Operation *op);

/// True if a derivative may pass from the operand to the results of its op: by
/// the rule of the op; without a rule, unless the op is discrete.
bool carriesDerivative(OpOperand &operand);

/// The ends of derivative paths: inputs and outputs of differentiation.
struct DerivativeEnds {
  /// A callback that tells whether a storage has an adjoint (reverse mode) or
  /// holds tangents (forward mode).
  llvm::function_ref<bool(Storage)> hasDerivative;
  /// The function's arguments and results that have a derivative.
  ArrayRef<Value> inputs = {}, outputs = {};
  /// True in forward mode, false in reverse mode.
  bool isForward = false;
};

/// Reports each op without a rule on a path from an input to an output, each
/// access through which such a path would pass memory that is not tracked, and
/// each store of a value with a derivative as another type.
LogicalResult verifyDerivativePaths(
    FunctionOpInterface function, const DerivativeEnds &ends,
    llvm::function_ref<InFlightDiagnostic(Operation *, const Twine &)>
        emitError);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_DERIVATIVEPATHS_H
