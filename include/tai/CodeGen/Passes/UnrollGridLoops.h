//===- UnrollGridLoops.h - Unroll grid-stride loops -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_PASSES_UNROLLGRIDLOOPS_H
#define TAI_CODEGEN_PASSES_UNROLLGRIDLOOPS_H

#include "llvm/IR/PassManager.h"

namespace mlir::tai {

/// A pass that unrolls grid-stride loops, all loads of the unrolled iterations
/// before all stores, so that more loads are in flight. For kernels of parallel
/// loops with independent, short iterations without branches. Runs after loop
/// simplification.
struct UnrollGridLoops : llvm::PassInfoMixin<UnrollGridLoops> {
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);
};

} // namespace mlir::tai

#endif // TAI_CODEGEN_PASSES_UNROLLGRIDLOOPS_H
