//===- LoweringPasses.h - What both targets begin with ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_PIPELINES_LOWERINGPASSES_H
#define TAI_LIB_PIPELINES_LOWERINGPASSES_H

#include "tai/Pipelines/Pipelines.h"

namespace mlir::tai {

/// The passes that see kernels as they were written: launches are fused,
/// helpers inlined, indices checked or clamped.
void addSourcePasses(OpPassManager &pm, const LoweringOptions &options);

/// Canonicalises, in time that grows with the program and no faster.
void addCanonicalization(OpPassManager &pm);

/// Adds passes that change one kernel or function at a time, and read nothing
/// of its module but what none of them changes: trees and fields. Kernels go
/// through all of them in parallel.
void addPerFunction(OpPassManager &pm,
                    llvm::function_ref<void(OpPassManager &)> add);

} // namespace mlir::tai

#endif // TAI_LIB_PIPELINES_LOWERINGPASSES_H
