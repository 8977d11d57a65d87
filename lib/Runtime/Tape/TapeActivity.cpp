//===- TapeActivity.cpp - Changes of activity by the host -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What the host does to the activity of a tree while a tape records, and what
// adjoints ask of it.
//
//===----------------------------------------------------------------------===//

#include "TapeMemory.h"
#include "TapeTopology.h"
#include "tai/Runtime/Tape/Tape.h"
#include <algorithm>
#include <utility>

using namespace mlir::tai::runtime;

Status Runtime::setActive(const TreePtr &tree, int64_t level, int64_t cell,
                          bool isActive) {
  auto change = [tree, level, cell, isActive]() {
    if (!tree->base())
      return Status::failure(StatusCode::Usage,
                             "tree '" + tree->name() + "' has been destroyed");
    SparseNode &node = *tree->sparseNodes()[level];
    if (isActive)
      node.activate(cell);
    else if (cell < 0)
      node.deactivateAll();
    else
      node.deactivate(cell);
    return Status::success();
  };
  auto held =
      std::find_if(fieldList.begin(), fieldList.end(),
                   [&](const FieldPtr &field) { return field->owner == tree; });
  if (held != fieldList.end())
    if (Status free = checkHold(**held, HoldKind::Write); !free)
      return free;
  if (Tape *tape = recordingTape())
    return tape->changeActivity(tree, change);
  // Without tapes nobody asks, and a device need not be waited for.
  SparseNode &node = *tree->sparseNodes()[level];
  uint64_t before = !tapes.empty() ? node.lastRemoval() : 0;
  Status status = change();
  // What inactive cells hold has become zero.
  if (!tapes.empty() && node.lastRemoval() != before)
    for (const FieldPtr &field : fieldList)
      if (field->owner == tree && field->sparseNode())
        ++field->hostVersion;
  return status;
}

void Tape::watch(const TreePtr &tree) { topology->watch(tree); }

Status Tape::changeActivity(const TreePtr &tree,
                            std::function<Status()> change) {
  watch(tree);
  auto index = static_cast<uint32_t>(records.size());
  for (const FieldPtr &field : runtime.fields()) {
    if (field->owner != tree || field->isAdjoint() || !field->sparseNode())
      continue;
    Status status = touch(field, HoldKind::Write);
    if (status)
      status = memory->beforeWrite(field, nullptr, index);
    if (!status)
      return status;
  }
  Status status = change();
  memory->settle();
  recordCallback({std::move(change), nullptr});
  return status;
}

Status Tape::callReverse(size_t index) {
  Tape *outer = std::exchange(runtime.sweeping, this);
  const void *thread = runtime.sweepThread.exchange(__builtin_thread_pointer());
  reverseFunction = index;
  Status status = callbacks[records[index].payload].backward();
  runtime.sweeping = outer;
  runtime.sweepThread = thread;
  return status;
}

Status Tape::findLoops(Kernel &kernel, LoopLists &lists, bool &found) {
  // Activity is what it was when the function was done.
  found = true;
  for (SparseNode *node : kernel.sparseNodes)
    lists.addUnknown(
        *node, node->list(runtime),
        topology->changes(static_cast<uint32_t>(reverseFunction), *node));
  return checkActivity(kernel, reverseFunction);
}

Status Tape::checkActivity(size_t index) {
  return checkActivity(*records[index].kernel, index);
}

Status Tape::checkActivity(Kernel &kernel, size_t index) {
  if (kernel.sparseNodes.empty())
    return Status::success();
  for (const FieldPtr &field : kernel.plan().activity)
    for (const SparseNode *node = field->sparseNode(); node;
         node = node->above())
      if (topology->changes(static_cast<uint32_t>(index), *node))
        return Status::failure(
            StatusCode::Usage,
            "kernel '" + kernel.name() + "' asks which cells of " +
                node->info().label + " are active, which the same " +
                (records[index].kernel ? "kernel" : "host function") +
                " changes, and its gradient needs the answers; make the "
                "changes in a kernel of their own");
  return Status::success();
}
