//===- TapeHolds.cpp - The fields that a tape uses ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "TapeHolds.h"

using namespace mlir::tai::runtime;

Status TapeHolds::add(const FieldPtr &field, HoldKind kind) {
  auto [entry, isNew] = used.try_emplace(field, kind);
  if (!isNew) {
    if (entry->second == kind || entry->second == HoldKind::Write)
      return Status::success();
    entry->second = HoldKind::Write;
  }
  if (!isHolding)
    return Status::success();
  Status status = services.hold(tape, *field, entry->second);
  if (!status) {
    used.erase(entry);
    return status;
  }
  // Gradients that another thread has left are set to zero, because the tape's
  // gradients start at zero.
  if (isNew && clears && field->isAdjoint() && field->isDirtiedByOther()) {
    const char zeros[8] = {};
    field->settleZeros();
    services.perform({HostWrite::What::Fill, field.get(), zeros});
    field->markClean();
  }
  return status;
}

Status TapeHolds::add(const Kernel &kernel) {
  bool reads = kernel.callerAdjoints().hasTargets;
  bool changes = kernel.callerAdjoints().hasSources();
  Status status;
  for (const Access &access : kernel.summary()) {
    if (status)
      status = add(access.field, holdKindOf(access.kind));
    // All fields of a tree share the activity of its cells, which the launch
    // depends on.
    if (status && access.field->sparseNode() && access.field->valid())
      status = add(services.firstOf(access.field->tree()), HoldKind::Write);
    if (access.field->adjoint())
      (access.kind == AccessKind::Read ? reads : changes) = true;
  }
  // A reverse sweep adds to the gradients of fields that were read, and treats
  // the gradients of changed fields as this tape's own.
  if (reads && changes)
    for (const Access &access : kernel.summary())
      if (status && access.field->sharedAdjoint())
        status = add(access.field->sharedAdjoint(), gradientKind());
  return status;
}

Status TapeHolds::hold() {
  if (!isHolding) {
    isHolding = true;
    services.beginHolding();
  }
  Status status;
  for (const auto &[field, kind] : used)
    if (status)
      status = services.hold(tape, *field, kind);
  return status;
}

void TapeHolds::release() {
  if (!isHolding)
    return;
  isHolding = false;
  for (const auto &[field, kind] : used)
    services.release(tape, *field);
  services.endHolding();
}
