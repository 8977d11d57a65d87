//===- ValueShadows.h - Adjoints of arguments and results -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_REVERSE_VALUESHADOWS_H
#define TAI_LIB_AD_REVERSE_VALUESHADOWS_H

#include "tai/AD/Reverse/AdjointBuilder.h"

namespace mlir::tai {

/// Emits loads of the adjoints of the function's results from memory of the
/// caller, at the start of the sweep.
void seedOutputs(AdjointBuilder &builder);
/// Emits, at the end of the sweep, additions of the adjoints of the function's
/// arguments to memory of the caller.
void accumulateInputs(AdjointBuilder &builder);

} // namespace mlir::tai

#endif // TAI_LIB_AD_REVERSE_VALUESHADOWS_H
