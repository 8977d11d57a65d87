//===- SplitComponents.h - Updates of components of a vector ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `v = f[c]; v[1] += e; f[c] = v` loads and stores whole vectors, and updates
// one component. Where other iterations may do so with the same element, the
// store becomes stores of the components that change, and the load becomes
// loads of the components that are used, which are updates by themselves.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_ACCUMULATIONS_SPLITCOMPONENTS_H
#define TAI_LIB_TRANSFORMS_ACCUMULATIONS_SPLITCOMPONENTS_H

#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

void splitComponents(ParallelForOp loop);

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_ACCUMULATIONS_SPLITCOMPONENTS_H
