//===- AggregateAtomics.h - One atomic addition for a warp ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_PASSES_AGGREGATEATOMICS_H
#define TAI_CODEGEN_PASSES_AGGREGATEATOMICS_H

#include "llvm/IR/PassManager.h"

namespace mlir::tai {

/// A pass that reduces the values of a warp first where all its threads add to
/// the same f32 elements, so that one thread adds to each element. For NVPTX.
/// With `combinesScatters`, it also handles data-dependent elements, after a
/// comparison at run time.
struct AggregateAtomics : llvm::PassInfoMixin<AggregateAtomics> {
  explicit AggregateAtomics(bool combinesScatters = true)
      : combinesScatters(combinesScatters) {}
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);

  bool combinesScatters;
};

} // namespace mlir::tai

#endif // TAI_CODEGEN_PASSES_AGGREGATEATOMICS_H
