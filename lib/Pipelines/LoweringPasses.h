//===- LoweringPasses.h - Common lowering passes ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_PIPELINES_LOWERINGPASSES_H
#define TAI_LIB_PIPELINES_LOWERINGPASSES_H

#include "tai/Pipelines/Pipelines.h"

namespace mlir::tai {

/// Adds passes that give kernels the modes in the options of their context.
void addContextModes(OpPassManager &pm, const LoweringOptions &options);
void addContextModes(OpPassManager &pm, const AutodiffOptions &options);

/// The first passes of both targets, on kernels as written: fusion of launches,
/// inlining, checking or clamping of indices.
void addSourcePasses(OpPassManager &pm, const LoweringOptions &options,
                     bool oneThread = false);

/// Adds MLIR's inliner, after a check of its limits, without its simplification
/// of every function, which costs more than all that follows.
void addInliner(OpPassManager &pm);

/// Adds a canonicalisation whose time is linear in the size of the program.
void addCanonicalization(OpPassManager &pm);

/// Adds passes that change one kernel or function at a time, and otherwise read
/// only the module's trees and fields, which no such pass changes. Kernels are
/// processed in parallel.
void addPerFunction(OpPassManager &pm,
                    llvm::function_ref<void(OpPassManager &)> add);

} // namespace mlir::tai

#endif // TAI_LIB_PIPELINES_LOWERINGPASSES_H
