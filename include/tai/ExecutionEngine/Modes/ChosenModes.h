//===- ChosenModes.h - The effect of modes on kernel code -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_MODES_CHOSENMODES_H
#define TAI_EXECUTIONENGINE_MODES_CHOSENMODES_H

#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/ExecutionEngine/Compile/Compiler.h"

namespace mlir::tai {

/// The compile options of a kernel in a context of `options`: the kernel's
/// modes take precedence. Emits an error at the kernel and fails if its modes
/// contradict each other, options of the context, or the abilities of the
/// target.
FailureOr<CompileOptions> getKernelOptions(KernelOp kernel,
                                           const CompileOptions &options);

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_MODES_CHOSENMODES_H
