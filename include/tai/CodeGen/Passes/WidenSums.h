//===- WidenSums.h - Sums of f32 in f64 -------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_PASSES_WIDENSUMS_H
#define TAI_CODEGEN_PASSES_WIDENSUMS_H

#include "llvm/IR/PassManager.h"

namespace mlir::tai {

/// Runs after the loop vectoriser: keeps the accumulators of reassociable f32
/// sums of a loop in f64, and rounds them after the loop.
struct WidenSums : llvm::PassInfoMixin<WidenSums> {
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);
};

} // namespace mlir::tai

#endif // TAI_CODEGEN_PASSES_WIDENSUMS_H
