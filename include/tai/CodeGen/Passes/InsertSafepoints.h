//===- InsertSafepoints.h - Polls in loops that may run long ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_PASSES_INSERTSAFEPOINTS_H
#define TAI_CODEGEN_PASSES_INSERTSAFEPOINTS_H

#include "llvm/IR/PassManager.h"

namespace mlir::tai {

/// True if a function may return early at a safepoint: a kernel, the body of a
/// parallel loop (see Abi.h), or an outlined part of such a body.
bool mayReturnEarly(const llvm::Function &function);

/// Inserts safepoint polls into kernels and bodies of parallel loops, at the
/// back edges of loops that may run long. After a tick of the clock, a poll
/// calls the runtime, and returns from the function if the runtime demands it.
/// Runs after the vectoriser, which does not vectorise loops with calls.
struct InsertSafepoints : llvm::PassInfoMixin<InsertSafepoints> {
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);
  static bool isRequired() { return true; }
};

} // namespace mlir::tai

#endif // TAI_CODEGEN_PASSES_INSERTSAFEPOINTS_H
