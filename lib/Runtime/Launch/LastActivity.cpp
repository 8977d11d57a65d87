//===- LastActivity.cpp - Cells that a launch visited ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/LastActivity.h"
#include "tai/Runtime/Launch/Kernel.h"

using namespace mlir::tai::runtime;

void LastActivity::begin(const std::vector<SparseNode *> &nodes) {
  std::lock_guard<std::mutex> lock(mutex);
  begins.clear();
  for (const SparseNode *node : nodes)
    begins.push_back(node->now());
  lists.clear();
}

void LastActivity::noteLoops(const LoopLists &loops) {
  std::lock_guard<std::mutex> lock(mutex);
  lists = loops;
}

Status LastActivity::check(Kernel &kernel, LoopLists &loops,
                           bool &wasLaunched) {
  const AdjointAccesses &wants = kernel.adjoint().plan();
  const std::vector<SparseNode *> &nodes = kernel.tables().sparseNodes;
  std::lock_guard<std::mutex> lock(mutex);
  if (nodes.empty() || begins.size() != nodes.size())
    return Status::success();
  wasLaunched = true;
  loops = lists;
  auto asksFor = [&](const SparseNode *node) {
    for (const FieldPtr &field : wants.activity)
      for (const SparseNode *at = field->sparseNode(); at; at = at->above())
        if (at == node)
          return true;
    return false;
  };
  for (size_t i = 0; i < nodes.size(); ++i) {
    const SparseNode *node = nodes[i];
    if (node->hasRemovedSince(begins[i]))
      return Status::failure(
          StatusCode::Usage,
          "cells of " + node->info().label +
              " were deactivated since kernel '" + kernel.name() +
              "' was launched, and its gradient needs them; launch it under a "
              "tape, or deactivate after the gradient");
    if (asksFor(node) && node->hasChangedSince(begins[i]))
      return Status::failure(
          StatusCode::Usage,
          "the gradient of kernel '" + kernel.name() +
              "' asks which cells of " + node->info().label +
              " are active, and that has changed since the kernel was "
              "launched; launch it under a tape");
  }
  return Status::success();
}
