//===- ManyLoops.h - Functions with hundreds of loops -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_PASSES_MANYLOOPS_H
#define TAI_LIB_CODEGEN_PASSES_MANYLOOPS_H

#include "llvm/ADT/StringRef.h"

namespace llvm {
class Module;
} // namespace llvm

namespace mlir::tai {

/// An attribute of functions that `divideManyLoops` has made. One that returns
/// an i32 has the frame for its first parameter, and may return 1 at any time,
/// upon which its caller returns as well.
constexpr llvm::StringLiteral kLoopPart = "tai-loop-part";

struct ManyLoopsLimits {
  /// Loops of a function: one that has more is divided.
  unsigned loops = 200;
  /// Loops of a part.
  unsigned part = 16;
};

/// Makes functions of loops that stand one behind the other, where a function
/// has hundreds: to run in front of all that optimises. What parts need of each
/// other is in memory that they share. True if something was divided: then no
/// pass may look through the calls, because polls come later that end a part.
bool divideManyLoops(llvm::Module &module, ManyLoopsLimits limits = {});

/// Whether a pass of LLVM changes what a part is given or returns.
bool looksThroughCalls(llvm::StringRef pass);

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_PASSES_MANYLOOPS_H
