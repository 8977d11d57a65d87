//===- LowerEach.cpp - A driver for one-to-one lowerings ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Transforms/Utils/LowerEach.h"
#include "mlir/Rewrite/PatternApplicator.h"

using namespace mlir;
using namespace mlir::tai;

LogicalResult tai::lowerEach(ArrayRef<Operation *> ops,
                             const FrozenRewritePatternSet &patterns) {
  if (ops.empty())
    return success();
  PatternApplicator applicator(patterns);
  applicator.applyDefaultCostModel();
  PatternRewriter rewriter(ops.front()->getContext());
  for (Operation *op : ops) {
    rewriter.setInsertionPoint(op);
    if (failed(applicator.matchAndRewrite(op, rewriter)))
      return failure();
  }
  return success();
}

LogicalResult tai::lowerAll(Operation *root,
                            const FrozenRewritePatternSet &patterns,
                            function_ref<bool(Operation *)> filter) {
  const auto &known = patterns.getOpSpecificNativePatterns();
  SmallVector<Operation *> ops;
  root->walk([&](Operation *op) {
    if (op != root && known.contains(op->getName()) && (!filter || filter(op)))
      ops.push_back(op);
  });
  return lowerEach(ops, patterns);
}
