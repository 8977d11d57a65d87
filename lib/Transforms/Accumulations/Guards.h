//===- Guards.h - Branches around an update ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `if a and b: store` and `if a: if b: store` hold the second condition in the
// branch of the first one. An update under one condition is easier to match.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_ACCUMULATIONS_GUARDS_H
#define TAI_LIB_TRANSFORMS_ACCUMULATIONS_GUARDS_H

#include "tai/Analysis/SharedElements.h"

namespace mlir::tai {

/// Joins the conditions around `store` into one, as far as their second parts
/// can be computed where the first ones do not hold: they have no effect, and
/// their loads stay inside their storages. `accesses` are those of the loop.
void joinGuards(DifferentiableAccessInterface store, ParallelForOp loop,
                const SameIteration &same,
                ArrayRef<DifferentiableAccessInterface> accesses);

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_ACCUMULATIONS_GUARDS_H
