//===- InsertSafepoints.h - Polls in loops that may run long ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_PASSES_INSERTSAFEPOINTS_H
#define TAI_LIB_CODEGEN_PASSES_INSERTSAFEPOINTS_H

#include "llvm/IR/PassManager.h"

namespace mlir::tai {

/// Whether a function may return at any time: a kernel, the body of a parallel
/// loop (see Abi.h), or a part of one.
bool mayReturnEarly(const llvm::Function &function);

/// Lets kernels and bodies of parallel loops look, at the back edges of loops
/// that may run long, whether there has been a tick since they last looked, and
/// return at once where the runtime says so. To be run after the vectoriser,
/// which leaves loops with calls alone.
struct InsertSafepoints : llvm::PassInfoMixin<InsertSafepoints> {
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);
  static bool isRequired() { return true; }
};

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_PASSES_INSERTSAFEPOINTS_H
