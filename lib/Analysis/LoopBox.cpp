//===- LoopBox.cpp - Parallel loops with known bounds ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/LoopBox.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/IndexBounds.h"
#include "tai/Dialect/Tai/IR/Layout.h"

using namespace mlir;
using namespace mlir::tai;

std::optional<unsigned> LoopBox::find(Value value) {
  auto argument = dyn_cast<BlockArgument>(value);
  if (!argument || argument.getOwner() != &body())
    return std::nullopt;
  return argument.getArgNumber();
}

std::optional<LoopBox> tai::getConstantBox(ParallelForOp loop) {
  if (loop.isStructFor()) {
    FieldLayout layout =
        *getFieldLayout(lookupField(loop, loop.getFieldAttr()));
    if (layout.path.getFirstSparse())
      return std::nullopt;
  }
  return getIndexBox(loop);
}

SmallVector<LoopBox> tai::findConstantBoxes(Operation *root) {
  SmallVector<LoopBox> boxes;
  root->walk([&](ParallelForOp loop) {
    if (loop.getSerialize() || loop.isStructFor() || checksIndices(loop) ||
        loop->getParentOfType<ParallelForOp>() ||
        loop.getInductionVars().empty())
      return;
    if (std::optional<LoopBox> box = getConstantBox(loop))
      boxes.push_back(std::move(*box));
  });
  return boxes;
}

std::optional<LoopBox> tai::getIndexBox(ParallelForOp loop) {
  LoopBox box{loop, {}, {}};
  if (loop.getLevel())
    return std::nullopt;
  if (loop.isStructFor()) {
    FieldLayout layout =
        *getFieldLayout(lookupField(loop, loop.getFieldAttr()));
    for (auto [extent, first] : llvm::zip(layout.shape, layout.offset)) {
      box.lower.push_back(first);
      box.upper.push_back(first + extent);
    }
    return box;
  }
  for (auto [lower, upper] :
       llvm::zip(loop.getLowerBounds(), loop.getUpperBounds())) {
    llvm::APInt low, high;
    if (!matchPattern(lower, m_ConstantInt(&low)) ||
        !matchPattern(upper, m_ConstantInt(&high)))
      return std::nullopt;
    box.lower.push_back(low.getSExtValue());
    box.upper.push_back(high.getSExtValue());
  }
  return box;
}
