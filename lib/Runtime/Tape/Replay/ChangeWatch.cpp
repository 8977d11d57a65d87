//===- ChangeWatch.cpp - Changes after a sequence ran ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "ChangeWatch.h"

using namespace mlir::tai::runtime;

void ChangeWatch::begin(const TapeMemory &memory) {
  versions.clear();
  for (const FieldPtr &field : services.fields())
    if (memory.isTouched(*field))
      versions.emplace_back(field, field->version());
  endLaunch = services.nextLaunch();
}

/// Adds the fields, other than adjoints, that launches of the kernel change.
static void addChangedBy(const Kernel &kernel, std::vector<Field *> &changed) {
  for (const Access &access : kernel.summary())
    if (access.kind != AccessKind::Read && !access.field->isAdjoint())
      changed.push_back(access.field.get());
}

Status ChangeWatch::check(const TapeMemory &memory,
                          std::vector<std::string> &notes,
                          bool &lostStored) const {
  lostStored = false;
  std::vector<Field *> byHost, byKernels;
  for (const auto &[field, version] : versions)
    if (field->version() != version)
      byHost.push_back(field.get());
  services.forEachKernel([&](Kernel &kernel) {
    // A kernel without code has not run, and its summary of accesses may be
    // unfinished.
    if (endLaunch > 0 && kernel.resolved() && kernel.lastLaunch() >= endLaunch)
      addChangedBy(kernel, byKernels);
  });
  auto check = [&](const std::vector<Field *> &changed, const char *how) {
    for (Field *field : changed) {
      if (memory.needsValues(*field))
        return Status::failure(
            StatusCode::Usage,
            "field '" + field->name() + "' was changed " + how +
                " after the tape had recorded, and the gradient needs what it "
                "held; replay the tape forward and backward instead");
      lostStored |= memory.isStored(*field);
      if (memory.isTouched(*field))
        notes.push_back("field '" + field->name() + "' was changed " + how +
                        " after the tape had recorded; the gradient is that "
                        "of what was recorded");
    }
    return Status::success();
  };
  Status status = check(byHost, "by the host");
  if (!status)
    return status;
  return check(byKernels, "by a kernel");
}
