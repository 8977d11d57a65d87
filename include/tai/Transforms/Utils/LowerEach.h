//===- LowerEach.h - Patterns that lower one op each ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The driver of lowerings that are done op by op. The greedy driver would fold
// and visit what patterns make; dialect conversion replaces values at the end
// only, while lowerings look at what the indices of an access are made of.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_LOWEREACH_H
#define TAI_TRANSFORMS_UTILS_LOWEREACH_H

#include "mlir/Rewrite/FrozenRewritePatternSet.h"

namespace mlir::tai {

/// Rewrites each of the ops by its pattern, in this order. Fails with the first
/// that has none, or whose pattern fails, which has said why.
LogicalResult lowerEach(ArrayRef<Operation *> ops,
                        const FrozenRewritePatternSet &patterns);

/// The same for all ops in `root` that have a pattern, in the order of a walk,
/// and of which `takes`, if given, is true.
LogicalResult lowerAll(Operation *root, const FrozenRewritePatternSet &patterns,
                       llvm::function_ref<bool(Operation *)> takes = nullptr);

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_LOWEREACH_H
