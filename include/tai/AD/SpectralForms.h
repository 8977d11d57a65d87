//===- SpectralForms.h - Functions of singular values -----------*- C++ -*-===//
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

#ifndef TAI_AD_SPECTRALFORMS_H
#define TAI_AD_SPECTRALFORMS_H

#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/Interfaces/FunctionInterfaces.h"

namespace mlir::tai {

/// Gives such products in a function a form to be differentiated by
/// (`tai.derive_as`), and takes these away again when it goes.
class SpectralForms {
public:
  explicit SpectralForms(FunctionOpInterface function);
  ~SpectralForms();
  SpectralForms(const SpectralForms &) = delete;
  SpectralForms &operator=(const SpectralForms &) = delete;

private:
  FunctionOpInterface function;
};

/// The value, as a constant to derivatives of a form that it is part of.
Value createConstantForm(ImplicitLocOpBuilder &builder, Value value);

/// Puts the value of each `tai.derive_as` in its place, and removes what only
/// the forms needed.
void dropForms(FunctionOpInterface function);

/// Warns at each decomposition of which `isActive` tells that derivatives pass
/// through a factor itself: where values are equal, how the factors turn
/// together gets zero there.
void warnOfTurningFactors(FunctionOpInterface function,
                          llvm::function_ref<bool(Value)> isActive);

} // namespace mlir::tai

#endif // TAI_AD_SPECTRALFORMS_H
