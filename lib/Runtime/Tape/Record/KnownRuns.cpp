//===- KnownRuns.cpp - Launches that need not run again -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "KnownRuns.h"
#include <algorithm>

using namespace mlir::tai::runtime;

/// The number of launches of one kernel that are known at a time.
static constexpr size_t kMostRuns = 64;

/// True if another field has the same place.
static bool isShared(const Field &field, const std::vector<FieldPtr> &fields) {
  return std::any_of(fields.begin(), fields.end(), [&](const FieldPtr &other) {
    return other.get() != &field && &other->tree() == &field.tree() &&
           other->layout().placeOffset == field.layout().placeOffset;
  });
}

/// True if a launch of the kernel depends on nothing but its arguments and the
/// fields that it reads, and writes other ones, all of whose writes count.
bool KnownRuns::isEligible(const Kernel &kernel) const {
  if (!kernel.isRepeatable() || kernel.resultSlots() != 0 ||
      kernel.callerAdjoints().slots != 0 || !kernel.arrays().empty() ||
      !kernel.tables().sparseNodes.empty())
    return false;
  const std::vector<Access> &summary = kernel.summary();
  return std::all_of(summary.begin(), summary.end(), [&](const Access &access) {
    const Field &field = *access.field;
    if (access.kind != AccessKind::Read && access.kind != AccessKind::Write)
      return false;
    for (const Access &other : summary)
      if (other.field == access.field && other.kind != access.kind)
        return false;
    return field.valid() && !field.isAdjoint() && !field.sparseNode() &&
           !field.tree().mirror() && !isShared(field, services.fields());
  });
}

bool KnownRuns::holds(const Kernel &kernel, const uint64_t *args) const {
  auto found = known.find(&kernel);
  if (found == known.end() || found->second.kernel.lock().get() != &kernel)
    return false;
  const std::vector<Access> &summary = kernel.summary();
  uint64_t epoch = services.epoch();
  uint64_t unknown = services.owner().launcher().unknownWrites();
  for (const Run &run : found->second.runs) {
    if (run.epoch != epoch || run.unknown != unknown ||
        !std::equal(run.args.begin(), run.args.end(), args))
      continue;
    bool isSame = true;
    for (size_t i = 0; i < summary.size() && isSame; ++i)
      isSame = summary[i].field->numWrites() == run.writes[i] &&
               !summary[i].field->tree().wasLent();
    if (isSame)
      return true;
  }
  return false;
}

void KnownRuns::note(Kernel &kernel, const uint64_t *args) {
  uint64_t epoch = services.epoch();
  Known &entry = known[&kernel];
  if (entry.kernel.lock().get() != &kernel || entry.epoch != epoch) {
    entry = Known();
    entry.kernel = kernel.weak_from_this();
    entry.epoch = epoch;
    entry.isEligible = isEligible(kernel);
  }
  if (!entry.isEligible)
    return;
  Run run;
  run.args.assign(args, args + kernel.tapeSlots());
  for (const Access &access : kernel.summary())
    run.writes.push_back(access.field->numWrites());
  run.epoch = epoch;
  run.unknown = services.owner().launcher().unknownWrites();
  for (Run &other : entry.runs)
    if (other.args == run.args) {
      other = std::move(run);
      return;
    }
  if (entry.runs.size() < kMostRuns) {
    entry.runs.push_back(std::move(run));
    return;
  }
  entry.runs[entry.next] = std::move(run);
  entry.next = (entry.next + 1) % kMostRuns;
}
