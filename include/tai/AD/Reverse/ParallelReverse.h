//===- ParallelReverse.h - The reverse of a parallel body -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_REVERSE_PARALLELREVERSE_H
#define TAI_AD_REVERSE_PARALLELREVERSE_H

#include "tai/AD/Reverse/AdjointBuilder.h"

namespace mlir::tai {

/// Reverses the body of a parallel loop into `mirror`, the body of `loop` in
/// the adjoint kernel. Contributions of iterations to captured values are
/// propagated to the reads that define the captured values; where no reads
/// define them, contributions are summed in memory by atomic adds. `begin` maps
/// the arguments, `terminate` adds the terminator.
LogicalResult reverseParallelBody(AdjointBuilder &builder, Operation *loop,
                                  Block &primal, Block &mirror,
                                  llvm::function_ref<void(Frame &)> begin,
                                  llvm::function_ref<void()> terminate);

} // namespace mlir::tai

#endif // TAI_AD_REVERSE_PARALLELREVERSE_H
