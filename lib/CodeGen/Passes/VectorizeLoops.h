//===- VectorizeLoops.h - The loop vectoriser, and a guard ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_PASSES_VECTORIZELOOPS_H
#define TAI_LIB_CODEGEN_PASSES_VECTORIZELOOPS_H

#include "llvm/IR/PassManager.h"
#include "llvm/Transforms/Vectorize/LoopVectorize.h"

namespace mlir::tai {

/// The loop vectoriser of LLVM, without two of its errors: loops whose accesses
/// to one element it would give another order stay scalar, and masked loads
/// stay where they are. Upstream folds a selection among a masked load into a
/// load in the place of the selection, past stores to the same memory.
struct VectorizeLoops : llvm::PassInfoMixin<VectorizeLoops> {
  explicit VectorizeLoops(llvm::LoopVectorizeOptions options)
      : options(options) {}
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);

private:
  llvm::LoopVectorizeOptions options;
};

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_PASSES_VECTORIZELOOPS_H
