//===- UnrollGridLoops.h - More loads on their way --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_PASSES_UNROLLGRIDLOOPS_H
#define TAI_LIB_CODEGEN_PASSES_UNROLLGRIDLOOPS_H

#include "llvm/IR/PassManager.h"

namespace mlir::tai {

/// Lets a thread run several iterations of a loop with the stride of the grid
/// at a time, all their loads before all their stores. For kernels of parallel
/// loops, whose iterations do not depend on each other, and of these for the
/// ones that are short and have no branches. After loops are simplified.
struct UnrollGridLoops : llvm::PassInfoMixin<UnrollGridLoops> {
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);
};

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_PASSES_UNROLLGRIDLOOPS_H
