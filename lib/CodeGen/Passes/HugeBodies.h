//===- HugeBodies.h - Compile time that grows with the program --*- C++ -*-===//
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

/// How much is too much for what takes more than linear time: some times what
/// the largest kernels of scenes have.
struct HugeBodyLimits {
  /// Instructions of a loop, once it is vectorised: such a loop stays as it is.
  unsigned vectorized = 5000;
  /// A loop's writes times its reads and writes: the vectoriser compares pairs.
  uint64_t loopPairs = 200000;
  /// Loops of a function: those of one with more are not unrolled.
  unsigned loops = 200;
  /// Instructions of a basic block that becomes machine code: a longer one is
  /// divided. No vectors are made of the statements of one.
  unsigned block = 8000;
  /// The same of a block's writes times its reads and writes: which of them may
  /// change places is asked of pairs.
  uint64_t pairs = 1500000;
  /// Instructions that a function takes over from a library: one that would
  /// have more calls it instead.
  uint64_t inlined = 30000;
  /// Instructions of a part of such a block.
  unsigned part = 1000;
};

/// Marks loops whose bodies would be huge as not to be vectorised, and those of
/// a function that has hundreds as not to be unrolled. To run in front of the
/// vectoriser. What compares accesses besides it has `canRun` to ask.
struct KeepHugeLoopsScalar : llvm::PassInfoMixin<KeepHugeLoopsScalar> {
  explicit KeepHugeLoopsScalar(HugeBodyLimits limits = {}) : limits(limits) {}
  llvm::PreservedAnalyses run(llvm::Function &function,
                              llvm::FunctionAnalysisManager &analyses);

  /// Whether a pass of LLVM takes acceptable time for what it is to work on.
  static bool canRun(llvm::StringRef pass, const llvm::Any &ir);

private:
  HugeBodyLimits limits;
};

/// Makes functions of the parts of blocks that are huge, to run behind all that
/// optimises. What parts need of each other is in memory that they share.
/// Without a target all instructions have one size.
void divideHugeBlocks(llvm::Module &module,
                      const llvm::TargetMachine *machine = nullptr,
                      HugeBodyLimits limits = {});

/// Keeps the calls of functions whose name begins like this, in functions that
/// would be huge with what they call. To run in front of the inliner.
void keepCallsInHugeFunctions(llvm::Module &module, llvm::StringRef prefix,
                              HugeBodyLimits limits = {});

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_PASSES_HUGEBODIES_H
