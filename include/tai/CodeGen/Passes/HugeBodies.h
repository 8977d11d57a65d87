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

/// Thresholds of code size above which passes of more than linear time are
/// avoided: several times the sizes of the largest kernels of the scenes.
struct HugeBodyLimits {
  /// The most instructions of a loop after vectorisation: larger loops are not
  /// vectorised.
  unsigned vectorized = 5000;
  /// The most pairs of accesses in a loop that is vectorised: the vectoriser
  /// compares each write with each access of the loop.
  uint64_t loopPairs = 200000;
  /// The most loops in a function whose loops are unrolled.
  unsigned loops = 200;
  /// The most instructions of a basic block before code generation: longer
  /// blocks are divided, and not SLP-vectorised.
  unsigned block = 8000;
  /// The most pairs of accesses in a block: the scheduler compares each write
  /// with each access, and blocks with more pairs are divided.
  uint64_t pairs = 1500000;
  /// The most instructions that are inlined into a function from a library;
  /// above this number, the library functions are called instead.
  uint64_t inlined = 30000;
  /// The number of instructions in each part of a divided block.
  unsigned part = 1000;
  /// The most instructions of a basic block in functions that call library
  /// functions because `inlined` was exceeded: longer blocks are divided.
  unsigned blockOfCalls = 8000;

  /// The limits of code size for a GPU. ptxas takes more than quadratic time
  /// for the calls in a block: 114 s for 800 and 1200 calls of f64 functions,
  /// and 9 s with blocks divided into parts of this size.
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

  /// True if the LLVM pass called `pass` takes acceptable time on the function
  /// or loop `ir`.
  static bool canRun(llvm::StringRef pass, const llvm::Any &ir);

private:
  HugeBodyLimits limits;
};

/// Outlines parts of huge blocks into functions; runs after all optimisations.
/// Values used across parts go through shared memory on the stack. Without a
/// target, all instructions count as one machine instruction.
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
