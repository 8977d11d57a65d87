//===- ChosenModes.h - What modes come to in the code of kernels -*- C++ -*-==//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_CHOSENMODES_H
#define TAI_EXECUTIONENGINE_CHOSENMODES_H

#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/ExecutionEngine/Compiler.h"

namespace mlir::tai {

/// The options of the code of a kernel in a context of `options`: what the
/// kernel says in its modes goes first. Fails after an error at the kernel
/// where these contradict one another, what the context says of others, or what
/// the target can do.
FailureOr<CompileOptions> getKernelOptions(KernelOp kernel,
                                           const CompileOptions &options);

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_CHOSENMODES_H
