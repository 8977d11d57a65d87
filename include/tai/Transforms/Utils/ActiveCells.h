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

/// Marks with kActiveAttrName the writes of a loop over a sparse field to the
/// cell of the iteration itself: this cell is active, and needs no test.
void markActive(ParallelForOp loop, FieldTable &fields);

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_ACTIVECELLS_H
