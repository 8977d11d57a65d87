//===- Signature.h - Extra operands of an adjoint function ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Fields name their adjoints; arrays, numbers and results do not. The adjoint
// of a kernel that is differentiated by them takes one more memref for each, at
// the end: it adds to those of arguments and reads those of results.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_SIGNATURE_H
#define TAI_AD_SIGNATURE_H

#include "mlir/IR/BuiltinTypes.h"
#include "mlir/Interfaces/FunctionInterfaces.h"

namespace mlir::tai {

/// The positions of what a kernel or function is differentiated by: those of
/// arguments, then, counted on, those of results. See getFunctionAttrName.
constexpr llvm::StringLiteral kGradients = "gradients";

struct AdjointSignature {
  SmallVector<unsigned> arguments;
  SmallVector<unsigned> results;

  /// What the attribute says; without it, all arrays of floats, if wanted.
  /// Fails after an error at the function if a position means no float.
  static FailureOr<AdjointSignature> get(FunctionOpInterface function,
                                         bool arrays);

  /// The memrefs of the adjoints, arguments first.
  SmallVector<MemRefType> getShadowTypes(FunctionOpInterface function) const;
};

/// Reports an error if `function` has no derivative by anything: what it takes
/// or what it gives is neither an array of floats that it accesses nor at one
/// of the positions that are differentiated by, if some are given.
LogicalResult checkHasDerivative(FunctionOpInterface function,
                                 ArrayRef<int64_t> positions);

/// The memref that holds the adjoint of a value of this type: of a number no
/// dimension, of a vector those of the vector, of an array its own and after
/// them those of its elements. Null for what has no adjoint.
MemRefType getShadowType(Type type);

} // namespace mlir::tai

#endif // TAI_AD_SIGNATURE_H
