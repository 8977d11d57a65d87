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

#include "../Mirror/DeviceCells.h"
#include "Launch.h"
#include <algorithm>

using namespace mlir::tai::runtime;

void Kernel::noteBegin() {
  std::lock_guard<std::mutex> lock(activityMutex);
  lastBegins.clear();
  for (const SparseNode *node : sparseNodes)
    lastBegins.push_back(node->now());
  lastLoops.clear();
}

void Kernel::noteLoops(const LoopLists &loops) {
  std::lock_guard<std::mutex> lock(activityMutex);
  lastLoops = loops;
}

Status Kernel::checkActivity(LoopLists &loops, bool &wasLaunched) {
  const AdjointPlan &wants = plan();
  std::lock_guard<std::mutex> lock(activityMutex);
  if (sparseNodes.empty() || lastBegins.size() != sparseNodes.size())
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
    if (node->hasRemovedSince(lastBegins[i]))
      return Status::failure(
          StatusCode::Usage,
          "cells of " + node->info().label +
              " were deactivated since kernel '" + name() +
              "' was launched, and its gradient needs them; launch it under a "
              "tape, or deactivate after the gradient");
    if (asksFor(node) && node->hasChangedSince(lastBegins[i]))
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

/// The list of the primal's loops over the level; null after a failure.
const LoopLists::Entry *Launch::findGiven(SparseNode &node) {
  const LoopLists::Entry *entry = given->find(node);
  bool differs = entry && entry->differs;
  if (entry && entry->mayDiffer) {
    Status status = findDifference(*given, node, differs);
    if (!status) {
      fail(std::move(status));
      return nullptr;
    }
  }
  if (entry && !differs)
    return entry;
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

ActiveListPtr Launch::visitedList(SparseNode &node) {
  if (given) {
    const LoopLists::Entry *entry = findGiven(node);
    if (!entry || entry->list)
      return entry ? entry->list : nullptr;
    // What a device has made is wanted by the host, which is rare.
    auto list = std::make_shared<ActiveList>();
    Status status = fetchCells(*entry->onDevice, list->cells);
    if (!status) {
      fail(std::move(status));
      return nullptr;
    }
    std::lock_guard<std::mutex> lock(failureMutex);
    fetched.push_back(list);
    return list;
  }
  ActiveListPtr list = node.list();
  std::lock_guard<std::mutex> lock(failureMutex);
  loops.add(node, list);
  return list;
}

const std::vector<int64_t> &Launch::cellsFor(SparseNode &node) {
  const std::vector<int64_t> &cells = visitedCells(node);
  return flags ? withoutVain(node, cells) : cells;
}
