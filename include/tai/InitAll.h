//===- InitAll.h - Registration of everything in tai ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The entry points for a compiler that embeds tai.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_INITALL_H
#define TAI_INITALL_H

#include "tai/Pipelines/Pipelines.h"

namespace mlir {
class DialectRegistry;
} // namespace mlir

namespace mlir::tai {

/// Registers the tai dialect, the upstream dialects that kernels are written
/// in and lowered to, and the interfaces that make their ops differentiable
/// and inlinable.
void registerAll(DialectRegistry &registry);

/// Registers the passes and pipelines of tai by name. Passes of upstream are
/// not registered.
void registerAllPasses();

/// Everything from kernels to the LLVM dialect: `tai-autodiff` for the kernels
/// launched under a tape, then `tai-to-llvm`.
void buildPipeline(OpPassManager &pm, const ToLLVMOptions &options);

} // namespace mlir::tai

#endif // TAI_INITALL_H
