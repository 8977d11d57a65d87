//===- LoopLevels.h - Kernels that only loop over active cells --*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A kernel that does nothing but loop over the active cells of sparse levels
// does nothing where there are none: its launch can be left out.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_LOOPLEVELS_H
#define TAI_EXECUTIONENGINE_LOOPLEVELS_H

#include "mlir/IR/BuiltinOps.h"
#include <cstdint>
#include <vector>

namespace mlir::tai {

/// Of the kernel whose entry point is `symbol`: pairs of a tree, by its
/// position in the module, and the number of a level in it. Empty where the
/// kernel does anything else too.
std::vector<int64_t> findLoopLevels(ModuleOp module, StringRef symbol);

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_LOOPLEVELS_H
