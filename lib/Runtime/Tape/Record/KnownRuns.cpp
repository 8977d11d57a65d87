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

std::string RunReason::describe() const {
  std::string name = field ? "@" + field->name() : "";
  switch (kind) {
  case None:
    return "its fields hold its results, since none of them has been written";
  case Unknown:
    return "no launch with these arguments is known to incremental tapes";
  case Written:
    return name + " has been written since";
  case Lent:
    return "an address in the memory of " + name +
           " was given away, so writes to it are not counted";
  case Uncounted:
    return "a replay, a program of the host or another unknown writer has run "
           "since";
  case Effects:
    return "the kernel draws random numbers, prints, calls functions, updates "
           "atomically or uses fields divided among processes";
  case Returns:
    return "the kernel returns values";
  case Arrays:
    return "the kernel uses arrays";
  case Sparse:
    return "a tree of the kernel's fields has sparse levels";
  case ReadsOwn:
    return "the kernel reads " + name + " and writes it";
  case Accumulates:
    return "the kernel accumulates into " + name;
  case Gradient:
    return name + " is a gradient";
  case Place:
    return name + " shares its place with another field";
  case Device:
    return name + " has a copy on a device";
  case OtherRecords:
    return "skip=-unchanged-launches, checkpoints, forward mode or several "
           "recording tapes run all launches";
  }
  __builtin_unreachable();
}

/// Returns None if a launch of the kernel depends on nothing but its arguments
/// and the fields that it reads, and writes other ones, all of whose writes
/// count.
RunReason KnownRuns::alwaysRuns(const Kernel &kernel) const {
  const std::vector<Access> &summary = kernel.summary();
  for (const Access &access : summary) {
    const Field &field = *access.field;
    if (access.kind != AccessKind::Read && access.kind != AccessKind::Write)
      return {RunReason::Accumulates, &field};
    for (const Access &other : summary)
      if (other.field == access.field && other.kind != access.kind)
        return {RunReason::ReadsOwn, &field};
    if (field.sparseNode())
      return {RunReason::Sparse};
    if (!field.valid())
      return {RunReason::Unknown};
    if (field.isAdjoint())
      return {RunReason::Gradient, &field};
    if (field.tree().mirror())
      return {RunReason::Device, &field};
    if (isShared(field, services.fields()))
      return {RunReason::Place, &field};
  }
  if (!kernel.tables().sparseNodes.empty())
    return {RunReason::Sparse};
  if (!kernel.arrays().empty())
    return {RunReason::Arrays};
  if (kernel.resultSlots() != 0 || kernel.callerAdjoints().slots != 0)
    return {RunReason::Returns};
  if (!kernel.isRepeatable())
    return {RunReason::Effects};
  return {};
}

RunReason KnownRuns::mustRun(const Kernel &kernel, const uint64_t *args) const {
  auto found = known.find(&kernel);
  if (found == known.end() || found->second.kernel.lock().get() != &kernel)
    return {RunReason::Unknown};
  if (found->second.always)
    return found->second.always;
  const std::vector<Access> &summary = kernel.summary();
  uint64_t epoch = services.epoch();
  uint64_t unknown = services.owner().launcher().unknownWrites();
  RunReason reason{RunReason::Unknown};
  for (const Run &run : found->second.runs) {
    if (run.epoch != epoch ||
        !std::equal(run.args.begin(), run.args.end(), args))
      continue;
    reason = {};
    if (run.unknown != unknown)
      reason = {RunReason::Uncounted};
    for (size_t i = 0; i < summary.size() && !reason; ++i) {
      const Field &field = *summary[i].field;
      if (field.tree().wasLent())
        reason = {RunReason::Lent, &field};
      else if (field.numWrites() != run.writes[i])
        reason = {RunReason::Written, &field};
    }
    if (!reason)
      return reason;
  }
  return reason;
}

void KnownRuns::note(Kernel &kernel, const uint64_t *args) {
  uint64_t epoch = services.epoch();
  Known &entry = known[&kernel];
  if (entry.kernel.lock().get() != &kernel || entry.epoch != epoch) {
    entry = Known();
    entry.kernel = kernel.weak_from_this();
    entry.epoch = epoch;
    entry.always = alwaysRuns(kernel);
  }
  if (entry.always)
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
