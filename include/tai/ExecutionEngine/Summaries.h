//===- Summaries.h - What kernels do to memory ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What a kernel reads, writes and accumulates, told from its IR in the words of
// the runtime.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_SUMMARIES_H
#define TAI_EXECUTIONENGINE_SUMMARIES_H

#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Runtime/Launch/Runtime.h"

namespace mlir::tai {

/// What the kernel does to the fields that the runtime has, the functions that
/// it calls included.
std::vector<runtime::Access> summarize(const runtime::Runtime &rt,
                                       ModuleOp module, KernelOp kernel);

/// Which floats that the kernel stores depend on which that it reads, with or
/// without gradients; of the fields of its summary, and of its arguments.
runtime::KernelFlows findFlows(KernelOp kernel,
                               ArrayRef<runtime::Access> summary);

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_SUMMARIES_H
