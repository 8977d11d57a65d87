//===- TapeActivity.cpp - Changes of activity by the host -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What the runtime does for tapes: begins them, and changes the activity of a
// tree where one may record.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/Runtime.h"
#include "tai/Runtime/Tape/Tape.h"
#include <algorithm>

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

Status Runtime::beginTape(FieldPtr loss, bool clear,
                          std::unique_ptr<Tape> &tape) {
  return Tape::begin(*this, ++stamps, std::move(loss), clear, tape);
}
