//===- TransposeColumns.h - Rows in the place of columns --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_PASSES_TRANSPOSECOLUMNS_H
#define TAI_CODEGEN_PASSES_TRANSPOSECOLUMNS_H

#include "llvm/IR/PassManager.h"

namespace mlir::tai {

/// Runs after the loop vectoriser: replaces gathers (scatters) of neighbouring
/// columns of a matrix by loads (stores) of pieces of rows and a transposition.
struct TransposeColumns : llvm::PassInfoMixin<TransposeColumns> {
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);
};

} // namespace mlir::tai

#endif // TAI_CODEGEN_PASSES_TRANSPOSECOLUMNS_H
