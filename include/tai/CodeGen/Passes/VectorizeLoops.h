//===- VectorizeLoops.h - The loop vectoriser, and a guard ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_PASSES_VECTORIZELOOPS_H
#define TAI_CODEGEN_PASSES_VECTORIZELOOPS_H

#include "llvm/IR/PassManager.h"
#include "llvm/Transforms/Vectorize/LoopVectorize.h"

namespace mlir::tai {

/// LLVM's loop vectoriser, without two of its errors: loops in which it would
/// change the order of accesses to an element stay scalar, and masked loads
/// stay where they are. Upstream folds a select of a masked load's result into
/// a load at the place of the select, past stores to the same memory.
struct VectorizeLoops : llvm::PassInfoMixin<VectorizeLoops> {
  explicit VectorizeLoops(llvm::LoopVectorizeOptions options)
      : options(options) {}
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);

private:
  llvm::LoopVectorizeOptions options;
};

} // namespace mlir::tai

#endif // TAI_CODEGEN_PASSES_VECTORIZELOOPS_H
