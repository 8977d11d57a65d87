//===- GroupLoads.h - Loads before stores -----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_PASSES_GROUPLOADS_H
#define TAI_CODEGEN_PASSES_GROUPLOADS_H

#include "llvm/IR/PassManager.h"

namespace mlir::tai {

/// Moves loads of a block up to earlier loads, past stores to other memory, so
/// that a GPU waits once for several loads. ptxas does not do so: it has no
/// alias information.
struct GroupLoads : llvm::PassInfoMixin<GroupLoads> {
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);
};

} // namespace mlir::tai

#endif // TAI_CODEGEN_PASSES_GROUPLOADS_H
