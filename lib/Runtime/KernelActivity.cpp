//===- KernelActivity.cpp - Activity that adjoints rely on ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An adjoint goes over the cells that its primal went over. Under a tape that
// is part of the record; an adjoint that is launched by hand belongs to the
// last launch of its primal, and finds here what that did.
//
//===----------------------------------------------------------------------===//

#include "Launch.h"
#include <algorithm>

using namespace mlir::tai::runtime;

void Kernel::noteEpochs() {
  std::lock_guard<std::mutex> lock(activityMutex);
  lastEpochs.clear();
  for (const SparseNode *node : sparseNodes)
    lastEpochs.push_back(node->epoch());
  lastLoops.clear();
}

void Kernel::noteLoops(const LoopLists &loops) {
  std::lock_guard<std::mutex> lock(activityMutex);
  lastLoops = loops;
}

Status Kernel::checkActivity(LoopLists &loops, bool &wasLaunched) {
  const AdjointPlan &wants = plan();
  std::lock_guard<std::mutex> lock(activityMutex);
  if (sparseNodes.empty() || lastEpochs.size() != sparseNodes.size())
    return Status::success();
  wasLaunched = true;
  loops = lastLoops;
  auto asksFor = [&](const SparseNode *node) {
    for (const FieldPtr &field : wants.activity)
      for (const SparseNode *at = field->sparseNode(); at; at = at->above())
        if (at == node)
          return true;
    return false;
  };
  for (size_t i = 0; i < sparseNodes.size(); ++i) {
    const SparseNode *node = sparseNodes[i];
    if (node->lastRemoval() > lastEpochs[i])
      return Status::failure(
          StatusCode::Usage,
          "cells of " + node->info().label +
              " were deactivated since kernel '" + name() +
              "' was launched, and its gradient needs them; launch it under a "
              "tape, or deactivate after the gradient");
    if (node->epoch() != lastEpochs[i] && asksFor(node))
      return Status::failure(
          StatusCode::Usage,
          "the gradient of kernel '" + name() + "' asks which cells of " +
              node->info().label +
              " are active, and that has changed since the kernel was "
              "launched; launch it under a tape");
  }
  return Status::success();
}

const std::vector<int64_t> &Launch::visitedCells(SparseNode &node) {
  static const std::vector<int64_t> none;
  // The list stays: `loops` or the record of the primal holds it.
  ActiveListPtr list = visitedList(node);
  return list ? list->cells : none;
}

ActiveListPtr Launch::visitedList(SparseNode &node) {
  if (!given) {
    ActiveListPtr list = node.list(owner());
    {
      std::lock_guard<std::mutex> lock(failureMutex);
      loops.add(node, list);
    }
    return list;
  }
  const LoopLists::Entry *entry = given->find(node);
  if (entry && !entry->differs)
    return entry->list;
  std::string what = "the gradient of kernel '" + *primalName + "' ";
  if (entry && owner().inReverseFunction())
    what += "loops over the active cells of " + node.info().label +
            ", and the host function that launched it has changed them; change "
            "them outside of that function";
  else if (entry)
    what += "needs the cells of " + node.info().label +
            " that each of its loops went over, but they went over different "
            "ones; split the kernel, with such a loop in each part";
  else
    what += "loops over the active cells of " + node.info().label +
            ", but there is no launch of the kernel that it could belong to";
  fail(Status::failure(StatusCode::Usage, std::move(what)));
  return nullptr;
}

const std::vector<int64_t> &Launch::cellsFor(SparseNode &node) {
  const std::vector<int64_t> &cells = visitedCells(node);
  return flags ? withoutVain(node, cells) : cells;
}
