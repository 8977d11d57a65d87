//===- LowerEach.h - A driver for one-to-one lowerings ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A pattern driver for lowerings op by op. The greedy driver would also fold
// and revisit new ops; dialect conversion replaces values only at the end, but
// lowerings inspect how the indices of an access are computed.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_LOWEREACH_H
#define TAI_TRANSFORMS_UTILS_LOWEREACH_H

#include "mlir/Rewrite/FrozenRewritePatternSet.h"

namespace mlir::tai {

/// Rewrites each of the ops by the pattern for its kind, in this order. Fails
/// at the first op without a pattern, or whose pattern fails (after an error).
LogicalResult lowerEach(ArrayRef<Operation *> ops,
                        const FrozenRewritePatternSet &patterns);

/// Rewrites all ops in `root` that have a pattern and for which `filter`, if
/// given, is true, in the order of a walk. Fails at the first op whose pattern
/// fails.
LogicalResult lowerAll(Operation *root, const FrozenRewritePatternSet &patterns,
                       llvm::function_ref<bool(Operation *)> filter = nullptr);

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_LOWEREACH_H
