//===- ActiveCells.h - Cells that are known to be active --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_ACTIVECELLS_H
#define TAI_TRANSFORMS_UTILS_ACTIVECELLS_H

#include "tai/Transforms/Utils/FieldAddress.h"

namespace mlir::tai {

/// Marks the writes of a loop over a sparse field that reach the cell of the
/// iteration itself: it is active, and need not be asked for.
void markActive(ParallelForOp loop, FieldTable &fields);

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_ACTIVECELLS_H
