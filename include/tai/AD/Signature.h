//===- Signature.h - Extra operands of an adjoint function ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Fields name their adjoints; arrays, numbers and results do not. The adjoint
// of a kernel that is differentiated with respect to arrays, numbers or results
// has one more memref operand for each, at the end. The adjoint adds to the
// memrefs of arguments, and reads the memrefs of results.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_SIGNATURE_H
#define TAI_AD_SIGNATURE_H

#include "mlir/IR/BuiltinTypes.h"
#include "mlir/Interfaces/FunctionInterfaces.h"

namespace mlir::tai {

/// The attribute with the positions that a kernel or function is differentiated
/// with respect to: arguments first, then results, numbered consecutively. See
/// getFunctionAttrName.
constexpr llvm::StringLiteral kGradients = "gradients";

struct AdjointSignature {
  SmallVector<unsigned> arguments;
  SmallVector<unsigned> results;

  /// The signature that the attribute `gradients` of `function` requests;
  /// without the attribute, all arrays of floats if `arrays`. Emits an error at
  /// the function and fails if a position is not the position of a float.
  static FailureOr<AdjointSignature> get(FunctionOpInterface function,
                                         bool arrays);

  /// The types of the memrefs that hold adjoints: of arguments first, then of
  /// results.
  SmallVector<MemRefType> getShadowTypes(FunctionOpInterface function) const;
};

/// Reports an error if `function` has nothing to differentiate: no argument or
/// result is an array of floats that it accesses, or is at one of `positions`.
LogicalResult checkHasDerivative(FunctionOpInterface function,
                                 ArrayRef<int64_t> positions);

/// The memref that holds the adjoint of a value of this type: of rank 0 for a
/// number, with the dimensions of a vector, or with the dimensions of an array
/// followed by the dimensions of its elements. Null for a type without an
/// adjoint.
MemRefType getShadowType(Type type);

} // namespace mlir::tai

#endif // TAI_AD_SIGNATURE_H
