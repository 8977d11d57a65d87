//===- TapeHolds.cpp - What a tape uses -----------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "../Host/HostWrite.h"
#include "../Launch/Launch.h"
#include "tai/Runtime/Launch/Runtime.h"
#include "tai/Runtime/Tape/Tape.h"

using namespace mlir::tai::runtime;

Status Tape::touch(const FieldPtr &field, HoldKind kind) {
  auto [entry, isNew] = touched.try_emplace(field, kind);
  if (!isNew) {
    if (entry->second == kind || entry->second == HoldKind::Write)
      return Status::success();
    entry->second = HoldKind::Write;
  }
  if (!holding)
    return Status::success();
  Status status = runtime.recordings().hold(*this, *field, entry->second);
  if (!status) {
    touched.erase(entry);
    return status;
  }
  // Left there by another thread before: a tape begins with gradients of zero.
  if (isNew && clears && field->isAdjoint() && field->isDirtiedByOther()) {
    const char zeros[8] = {};
    field->settleZeros();
    runtime.perform({HostWrite::What::Fill, field.get(), zeros});
    field->markClean();
  }
  return status;
}

Status Tape::touch(const Kernel &kernel) {
  bool reads = kernel.callerAdjoints().hasTargets;
  bool changes = kernel.callerAdjoints().hasSources();
  Status status;
  for (const Access &access : kernel.summary()) {
    if (status)
      status = touch(access.field, holdKindOf(access.kind));
    // What is active is part of the sequence, and the same for all fields.
    if (status && access.field->sparseNode() && access.field->valid())
      status =
          touch(runtime.store().firstOf(access.field->tree()), HoldKind::Write);
    if (access.field->adjoint())
      (access.kind == AccessKind::Read ? reads : changes) = true;
  }
  // A sweep adds to the gradients of what is read, and takes those of what is
  // changed to be of this tape.
  HoldKind kind = clears ? HoldKind::Write : HoldKind::Add;
  if (reads && changes)
    for (const Access &access : kernel.summary())
      if (status && access.field->sharedAdjoint())
        status = touch(access.field->sharedAdjoint(), kind);
  return status;
}

Status Tape::holdFields() {
  if (!holding) {
    holding = true;
    runtime.recordings().beginHolding();
  }
  Status status;
  for (const auto &[field, kind] : touched)
    if (status)
      status = runtime.recordings().hold(*this, *field, kind);
  return status;
}

void Tape::releaseFields() {
  if (!holding)
    return;
  holding = false;
  for (const auto &[field, kind] : touched)
    runtime.recordings().release(*this, *field);
  runtime.recordings().endHolding();
}

Status Tape::clearGradients() {
  Status status = holdFields();
  if (status)
    runtime.clearGradients(this);
  releaseFields();
  return status;
}
