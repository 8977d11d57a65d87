//===- HugeBodies.h - Limits of superlinear passes --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_PASSES_HUGEBODIES_H
#define TAI_CODEGEN_PASSES_HUGEBODIES_H

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
  /// Limit of the instructions of a loop after vectorisation: larger loops are
  /// not vectorised.
  unsigned vectorized = 5000;
  /// Writes of a loop times its accesses, which is the number of pairs that the
  /// vectoriser compares: loops with more pairs are not vectorised.
  uint64_t loopPairs = 200000;
  /// Limit of the loops of a function: if there are more, loops are not
  /// unrolled.
  unsigned loops = 200;
  /// Limit of the instructions of a basic block before code generation: longer
  /// blocks are divided, and not SLP-vectorised.
  unsigned block = 8000;
  /// Writes of a block times its accesses, which is the number of pairs that
  /// the scheduler compares: blocks with more pairs are divided.
  uint64_t pairs = 1500000;
  /// Limit of the instructions that are inlined into a function from a library:
  /// above it, the library functions are called instead.
  uint64_t inlined = 30000;
  /// Number of instructions in each part of a divided block.
  unsigned part = 1000;
  /// Limit of the instructions of a basic block in functions that call library
  /// functions because `inlined` was exceeded: longer blocks are divided.
  unsigned blockOfCalls = 8000;

  /// The limits for a GPU. ptxas takes more than quadratic time for the calls
  /// in a block: 114 s for 800 and 1200 calls of f64 functions, and 9 s with
  /// blocks divided into parts of this size.
  static HugeBodyLimits ofDevice() {
    HugeBodyLimits limits;
    limits.block = ~0u;
    limits.pairs = ~uint64_t(0);
    limits.blockOfCalls = 400;
    limits.part = 200;
    return limits;
  }
};

/// Disables vectorisation of loops whose bodies would become huge, and
/// unrolling of loops in functions with hundreds of loops. Runs before the
/// vectoriser. `canRun` skips other passes that compare pairs of accesses.
struct KeepHugeLoopsScalar : llvm::PassInfoMixin<KeepHugeLoopsScalar> {
  explicit KeepHugeLoopsScalar(HugeBodyLimits limits = {}) : limits(limits) {}
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);

  /// Whether the LLVM pass with the name `pass` takes acceptable time on the
  /// function or loop `ir`.
  static bool canRun(llvm::StringRef pass, const llvm::Any &ir);

private:
  HugeBodyLimits limits;
};

/// Outlines parts of huge blocks into functions; runs after all optimisations.
/// Values used across parts go through shared memory on the stack. Without a
/// target, all instructions count as one.
void divideHugeBlocks(llvm::Module &module,
                      const llvm::TargetMachine *machine = nullptr,
                      HugeBodyLimits limits = {});

/// In functions that would become huge by inlining, keeps calls of functions
/// whose name begins with `prefix`, and marks the functions for
/// `divideHugeBlocks`. Runs before the inliner.
void keepCallsInHugeFunctions(llvm::Module &module, llvm::StringRef prefix,
                              HugeBodyLimits limits = {});

} // namespace mlir::tai

#endif // TAI_CODEGEN_PASSES_HUGEBODIES_H
