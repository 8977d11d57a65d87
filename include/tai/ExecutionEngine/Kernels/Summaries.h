//===- Summaries.h - Access summaries for the runtime -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The fields that a kernel reads, writes and accumulates: converts the results
// of the analyses to the types of the runtime.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_KERNELS_SUMMARIES_H
#define TAI_EXECUTIONENGINE_KERNELS_SUMMARIES_H

#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Runtime/Launch/Runtime.h"

namespace mlir::tai {

/// Lists the accesses of a kernel, and of the functions that it calls, to
/// fields of the runtime.
std::vector<runtime::Access> summarize(const runtime::Runtime &rt,
                                       ModuleOp module, KernelOp kernel);

/// Finds which stored floats of a kernel depend on which loaded floats, with or
/// without gradients, for the fields in its summary and for its arguments.
runtime::KernelFlows findFlows(KernelOp kernel,
                               ArrayRef<runtime::Access> summary);

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_KERNELS_SUMMARIES_H
