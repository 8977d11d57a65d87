//===- LoopLevels.cpp - Kernels that only loop over active cells ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/LoopLevels.h"
#include "SparseLoops.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"

using namespace mlir;
using namespace mlir::tai;

/// Returns the number of the sparse level over whose active cells the loop
/// runs; none for other loops.
static std::optional<unsigned>
getListLevel(ParallelForOp loop, const DataLayout &dataLayout, TreeOp &tree) {
  std::optional<FieldLayout> layout = getSparseLayout(loop);
  if (!layout)
    return std::nullopt;
  tree = layout->tree;
  // The loop runs over the list of the innermost sparse level that it covers.
  unsigned covered =
      layout->path.levels.size() + 1 - loop.getLevel().value_or(1);
  std::optional<unsigned> node;
  for (auto [level, number] : getFieldStorage(*layout, dataLayout).sparse)
    if (level < covered)
      node = number;
  return node;
}

std::vector<int64_t> mlir::tai::findLoopLevels(KernelOp kernel) {
  if (kernel->getNumRegions() != 1 || !kernel.getResultTypes().empty() ||
      !kernel.getBody().hasOneBlock())
    return {};
  auto module = kernel->getParentOfType<ModuleOp>();
  auto trees = llvm::to_vector(module.getOps<TreeOp>());
  DataLayout dataLayout(module);
  std::vector<int64_t> levels;
  for (Operation &op : kernel.getBody().front().without_terminator()) {
    if (auto loop = dyn_cast<ParallelForOp>(op)) {
      TreeOp tree;
      std::optional<unsigned> node = getListLevel(loop, dataLayout, tree);
      if (!node)
        return {};
      levels.push_back(llvm::find(trees, tree) - trees.begin());
      levels.push_back(*node);
    } else if (!isMemoryEffectFree(&op) &&
               !hasSingleEffect<MemoryEffects::Read>(&op)) {
      return {};
    }
  }
  return levels;
}
