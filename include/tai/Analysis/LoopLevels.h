//===- LoopLevels.h - Kernels that only loop over active cells --*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The launch of a kernel that only loops over the active cells of sparse levels
// can be skipped where no cell is active.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_LOOPLEVELS_H
#define TAI_ANALYSIS_LOOPLEVELS_H

#include "tai/Dialect/Tai/IR/Tai.h"
#include <cstdint>
#include <vector>

namespace mlir::tai {

/// The sparse levels over whose active cells the kernel loops, as consecutive
/// pairs: the tree, by its position in the module of the kernel, and the number
/// of the level in the tree. Empty for a kernel that does more than such loops.
std::vector<int64_t> findLoopLevels(KernelOp kernel);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_LOOPLEVELS_H
