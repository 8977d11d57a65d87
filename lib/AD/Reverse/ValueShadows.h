//===- ValueShadows.h - Adjoints of arguments and results -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_REVERSE_VALUESHADOWS_H
#define TAI_LIB_AD_REVERSE_VALUESHADOWS_H

#include "tai/AD/AdjointBuilder.h"

namespace mlir::tai {

/// At the start of the sweep: the adjoints of what the function returned.
void seedOutputs(AdjointBuilder &builder);
/// At its end: adds the adjoints of arguments to the memory of the caller.
void accumulateInputs(AdjointBuilder &builder);

} // namespace mlir::tai

#endif // TAI_LIB_AD_REVERSE_VALUESHADOWS_H
