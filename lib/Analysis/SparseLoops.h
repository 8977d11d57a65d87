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

/// The layout of the sparse field that the loop visits; none for other loops.
inline std::optional<FieldLayout> getSparseLayout(ParallelForOp loop) {
  if (!loop.isStructFor())
    return std::nullopt;
  FieldOp field = lookupField(loop, loop.getFieldAttr());
  FailureOr<FieldLayout> layout =
      field ? getFieldLayout(field) : FailureOr<FieldLayout>(failure());
  if (failed(layout) || !layout->path.getFirstSparse())
    return std::nullopt;
  return *layout;
}

} // namespace mlir::tai

#endif // TAI_LIB_ANALYSIS_SPARSELOOPS_H
