//===- HugeBodies.h - Limits of superlinear passes --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_PASSES_HUGEBODIES_H
#define TAI_LIB_CODEGEN_PASSES_HUGEBODIES_H

#include "llvm/ADT/Any.h"
#include "llvm/ADT/StringRef.h"
#include "llvm/IR/PassManager.h"
#include <cstdint>

namespace llvm {
class TargetMachine;
} // namespace llvm

namespace mlir::tai {

/// Thresholds above which passes of more than linear time are avoided: several
/// times the sizes of the largest kernels of the scenes.
struct HugeBodyLimits {
  /// Instructions of a loop after vectorisation: a larger loop is not
  /// vectorised.
  unsigned vectorized = 5000;
  /// Writes of a loop times its accesses: a loop with more such pairs, each of
  /// which the vectoriser compares, is not vectorised.
  uint64_t loopPairs = 200000;
  /// Loops of a function: with more, they are not unrolled.
  unsigned loops = 200;
  /// Instructions of a basic block before code generation: a longer one is
  /// divided, and not SLP-vectorised.
  unsigned block = 8000;
  /// The same for a block's writes times its accesses: the scheduler compares
  /// pairs.
  uint64_t pairs = 1500000;
  /// Instructions inlined into a function from a library: above it, the library
  /// function is called.
  uint64_t inlined = 30000;
  /// Instructions of each part of a divided block.
  unsigned part = 1000;
  /// The same as `block`, of functions in which calls were kept.
  unsigned blockOfCalls = 8000;

  /// For a GPU: ptxas takes more than quadratic time for the calls of a block,
  /// 114 s for 800 and 1200 of f64, and 9 s once they are in such parts.
  static HugeBodyLimits ofDevice() {
    HugeBodyLimits limits;
    limits.block = ~0u;
    limits.pairs = ~uint64_t(0);
    limits.blockOfCalls = 400;
    limits.part = 200;
    return limits;
  }
};

/// Marks loops whose bodies would be huge as not to be vectorised, and those of
/// a function that has hundreds as not to be unrolled. Runs before the
/// vectoriser. Other passes that compare pairs of accesses are skipped by
/// `canRun`.
struct KeepHugeLoopsScalar : llvm::PassInfoMixin<KeepHugeLoopsScalar> {
  explicit KeepHugeLoopsScalar(HugeBodyLimits limits = {}) : limits(limits) {}
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);

  /// Whether a pass of LLVM takes acceptable time on `ir`.
  static bool canRun(llvm::StringRef pass, const llvm::Any &ir);

private:
  HugeBodyLimits limits;
};

/// Outlines parts of huge blocks into functions; runs after all optimisations.
/// Values used across parts go through shared memory on the stack. Without a
/// target all instructions count the same.
void divideHugeBlocks(llvm::Module &module,
                      const llvm::TargetMachine *machine = nullptr,
                      HugeBodyLimits limits = {});

/// In functions that would become huge by inlining, keeps calls of functions
/// whose name begins with `prefix`, and marks the functions for
/// `divideHugeBlocks`. Runs before the inliner.
void keepCallsInHugeFunctions(llvm::Module &module, llvm::StringRef prefix,
                              HugeBodyLimits limits = {});

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_PASSES_HUGEBODIES_H
