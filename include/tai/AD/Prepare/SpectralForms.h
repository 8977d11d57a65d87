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

/// Attaches to products of the factors of a decomposition the equivalent
/// function of the decomposed matrix, which is differentiated instead
/// (`tai.derive_as`), and removes these forms when destroyed.
class SpectralForms {
public:
  explicit SpectralForms(FunctionOpInterface function);
  ~SpectralForms();
  SpectralForms(const SpectralForms &) = delete;
  SpectralForms &operator=(const SpectralForms &) = delete;

private:
  FunctionOpInterface function;
};

/// Returns `value` as a constant for differentiation: derivatives of a form
/// that uses the constant do not pass through it.
Value createConstantForm(ImplicitLocOpBuilder &builder, Value value);

/// Replaces each `tai.derive_as` op by the value that the program computed, and
/// erases ops that only the differentiated forms used.
void dropForms(FunctionOpInterface function);

/// Warns at each decomposition with an active factor (`isActive`): where
/// singular values are equal, the common rotation of the factors is
/// undetermined and contributes zero.
void warnOfActiveFactors(FunctionOpInterface function,
                         llvm::function_ref<bool(Value)> isActive);

} // namespace mlir::tai

#endif // TAI_AD_PREPARE_SPECTRALFORMS_H
