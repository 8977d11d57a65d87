//===- ManyLoops.h - Functions with hundreds of loops -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_PASSES_MANYLOOPS_H
#define TAI_CODEGEN_PASSES_MANYLOOPS_H

#include "llvm/ADT/StringRef.h"

namespace llvm {
class Module;
} // namespace llvm

namespace mlir::tai {

/// An attribute of functions that `divideManyLoops` creates. If such a function
/// returns an i32, its first parameter is the frame, and it may return 1 early;
/// its caller then returns as well.
constexpr llvm::StringLiteral kLoopPart = "tai-loop-part";

struct ManyLoopsLimits {
  /// The most loops of a function: functions with more loops are divided.
  unsigned loops = 200;
  /// Loops of a part.
  unsigned part = 16;
};

/// Outlines groups of consecutive loops of functions with hundreds of loops;
/// runs before all optimisations. Values used across parts go through shared
/// memory on the stack. True if a function was divided: then no interprocedural
/// pass may run, because safepoints that are inserted later let a part return
/// early.
bool divideManyLoops(llvm::Module &module, ManyLoopsLimits limits = {});

/// True if the LLVM pass called `pass` is interprocedural. Such a pass may
/// change the arguments or the result of an outlined part.
bool looksThroughCalls(llvm::StringRef pass);

} // namespace mlir::tai

#endif // TAI_CODEGEN_PASSES_MANYLOOPS_H
