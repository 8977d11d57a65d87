//===- SpectralForms.h - Matrix functions of an SVD -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Products U M Vᵀ of the two factors of one decomposition and a diagonal
// matrix, M = f(Σ) most often, are functions of the matrix that was decomposed,
// with a derivative also where singular values are equal and U and V have none.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_PREPARE_SPECTRALFORMS_H
#define TAI_AD_PREPARE_SPECTRALFORMS_H

#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/Interfaces/FunctionInterfaces.h"

namespace mlir::tai {

/// Attaches to such products in a function the form that is differentiated
/// instead (`tai.derive_as`), and removes these forms when it is destroyed.
class SpectralForms {
public:
  explicit SpectralForms(FunctionOpInterface function);
  ~SpectralForms();
  SpectralForms(const SpectralForms &) = delete;
  SpectralForms &operator=(const SpectralForms &) = delete;

private:
  FunctionOpInterface function;
};

/// The value as a constant: derivatives of a form that uses it do not pass
/// through it.
Value createConstantForm(ImplicitLocOpBuilder &builder, Value value);

/// Replaces each `tai.derive_as` by its value, and erases ops that only the
/// forms used.
void dropForms(FunctionOpInterface function);

/// Warns at each decomposition with an active factor (`isActive`): where
/// singular values are equal, the common rotation of the factors is
/// undetermined and contributes zero.
void warnOfActiveFactors(FunctionOpInterface function,
                         llvm::function_ref<bool(Value)> isActive);

} // namespace mlir::tai

#endif // TAI_AD_PREPARE_SPECTRALFORMS_H
