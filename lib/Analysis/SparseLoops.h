//===- SparseLoops.h - Loops over sparse fields -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_ANALYSIS_SPARSELOOPS_H
#define TAI_LIB_ANALYSIS_SPARSELOOPS_H

#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// Returns the layout of the sparse field that the loop visits; nothing for
/// other loops.
inline std::optional<FieldLayout> getSparseLayout(ParallelForOp loop) {
  if (!loop.isStructFor())
    return std::nullopt;
  FieldLayout layout = *getFieldLayout(lookupField(loop, loop.getFieldAttr()));
  return layout.path.getFirstSparse() ? std::optional(std::move(layout))
                                      : std::nullopt;
}

} // namespace mlir::tai

#endif // TAI_LIB_ANALYSIS_SPARSELOOPS_H
