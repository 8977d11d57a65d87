//===- Rematerialiser.cpp - Checkpointed reverse sweeps -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Rematerialiser.h"
#include "../Replay/ForwardReplay.h"
#include <algorithm>

using namespace mlir::tai::runtime;

Status Rematerialiser::setPolicy(CheckpointPolicy policy) {
  if (policy.snapshots < 0 || policy.budget < 0)
    return Status::failure(StatusCode::Usage,
                           "the number of snapshots and the memory budget of a "
                           "tape must be positive");
  checkpoints.reset();
  if (policy.kind != CheckpointPolicy::Kind::None)
    checkpoints = std::make_unique<Checkpoints>(services.owner(), policy);
  memory.useCheckpoints(checkpoints.get());
  return Status::success();
}

void Rematerialiser::restart() {
  sweptBefore = false;
  executed = 0;
  executedAt.clear();
}

/// Calls body(track, range) for each part of a field that the record can change
/// and that the tape restores (TapeMemory::followedFor).
template <typename Body>
Status Rematerialiser::forEachChange(size_t index, const Body &body) {
  const TapeRecording::Record &record = recording[index];
  auto visit = [&](Track &changed, SlabRange changedRange) {
    auto [track, range] = memory.followedFor(changed, changedRange);
    return track ? body(*track, range) : Status::success();
  };
  if (record.kind == TapeRecording::Kind::Launch) {
    const uint64_t *args = recording.args(record);
    for (const TapeMemory::Use &use : memory.usesOf(*record.kernel).changes) {
      Status status = visit(*use.track, use.locate(args));
      if (!status)
        return status;
    }
    return Status::success();
  }
  const std::vector<TapeMemory::Part> &changes = memory.partsAt(index);
  for (const TapeMemory::Part &part : changes) {
    Status status = visit(*part.track, part.range);
    if (!status)
      return status;
  }
  return Status::success();
}

Status Rematerialiser::recompute(Launch &launch, size_t index, bool saving,
                                 size_t oldest) {
  topology.goBefore(static_cast<uint32_t>(index));
  bool changesFollowed = false;
  Status status = forEachChange(index, [&](Track &track, SlabRange range) {
    changesFollowed = true;
    return checkpoints->log(track, range);
  });
  if (status && saving)
    status = memory.beforeReplay(static_cast<uint32_t>(index),
                                 static_cast<uint32_t>(oldest));
  topology.beginReexecution(static_cast<uint32_t>(index));
  // A host write that changes only tangents of gradients is not repeated.
  if (status &&
      (changesFollowed || recording[index].kind != TapeRecording::Kind::Write))
    status = replayRecord(services, recording, launch, index,
                          !memory.partsAt(index).empty());
  checkpoints->settle();
  memory.settle();
  topology.endReexecution(static_cast<uint32_t>(index));
  ++executed;
  executedAt.resize(recording.size());
  ++executedAt[index];
  return status;
}

Status Rematerialiser::recomputeRange(Launch &launch, size_t from, size_t to) {
  Status status;
  for (size_t i = from; i < to && status; ++i)
    status = recompute(launch, i, /*saving=*/false, 0);
  return status;
}

/// True if the sweep has anything to do at the record.
bool Rematerialiser::mayNeed(size_t index) const {
  return recording.callsInReverse() || TapePlan::isReplayed(plan[index]);
}

/// Reverses the records [from, to): re-executes them, saving the values that
/// they overwrite, then runs their adjoints. Memory must be as before record
/// `from`; it is unspecified afterwards.
Status Rematerialiser::reverseSaving(Launch &launch, size_t from, size_t to) {
  memory.beginSegment(static_cast<uint32_t>(from));
  Status status;
  for (size_t i = from; i < to && status; ++i)
    status = recompute(launch, i, /*saving=*/true, from);
  if (status)
    status = memory.beginReverse();
  for (size_t i = to; i-- > from && status;)
    status = reverse.reverse(launch, i);
  memory.beginSegment(0);
  return status;
}

int64_t Rematerialiser::freeSnapshots() const {
  const CheckpointPolicy &policy = checkpoints->chosenPolicy();
  if (policy.budget > 0)
    return (policy.budget - checkpoints->bytes() - checkpoints->growth()) /
               std::max<int64_t>(checkpoints->snapshotBytes(), 1) -
           1; // room for the values of the record that is being reversed
  return std::max<int64_t>(policy.snapshots, 1) - checkpoints->count();
}

bool Rematerialiser::isShort(size_t from, size_t to) const {
  const CheckpointPolicy &policy = checkpoints->chosenPolicy();
  if (to - from == 1 || policy.kind == CheckpointPolicy::Kind::Periodic)
    return true;
  if (policy.kind != CheckpointPolicy::Kind::Mixed)
    return false;
  int64_t room = policy.budget > 0 ? policy.budget - checkpoints->bytes() -
                                         checkpoints->growth()
                                   : checkpoints->snapshotBytes();
  return memory.mostBytes(static_cast<uint32_t>(from),
                          static_cast<uint32_t>(to)) <= room;
}

/// Drops the topmost snapshot, and restores memory to the snapshot below it.
Status Rematerialiser::dropTop() {
  Status status = checkpoints->restore();
  if (!status)
    return status;
  checkpoints->pop();
  return checkpoints->restore();
}

/// Reverses the records [from, to). Memory must be as before record `from`,
/// where the topmost snapshot is; it is unspecified afterwards.
Status Rematerialiser::reverseRange(Launch &launch, size_t from, size_t to) {
  Status status;
  while (status) {
    for (; to > from && !mayNeed(to - 1); --to)
      services.count(TapePlan::counterOf(plan[to - 1]));
    if (to == from)
      return status;
    if (isShort(from, to))
      return reverseSaving(launch, from, to);
    int64_t free = freeSnapshots();
    if (free <= 0) {
      // Every record of this range is re-executed from this one snapshot.
      status = recomputeRange(launch, from, to - 1);
      if (status)
        status = reverseSaving(launch, to - 1, to);
      --to;
      if (status)
        status = checkpoints->restore();
      continue;
    }
    size_t middle = from + static_cast<size_t>(binomialSplit(
                               static_cast<int64_t>(to - from), free + 1));
    status = recomputeRange(launch, from, middle);
    if (!status)
      return status;
    checkpoints->push(static_cast<uint32_t>(middle));
    status = reverseRange(launch, middle, to);
    if (status)
      status = dropTop();
    to = middle;
  }
  return status;
}

/// The number of snapshots, from the first on, to keep for a sweep. The number
/// of records is known now, so dropping later snapshots can make room for
/// better placed ones.
int64_t Rematerialiser::bestSnapshots() const {
  int64_t count = checkpoints->count();
  int64_t all = count + std::max<int64_t>(freeSnapshots(), 0);
  int64_t best = count, bestCost = INT64_MAX, before = 0;
  for (int64_t kept = 1; kept <= count; ++kept) {
    int64_t left = all - kept + 1;
    int64_t start = checkpoints->start(kept - 1);
    int64_t cost =
        before +
        binomialCost(static_cast<int64_t>(recording.size()) - start, left);
    if (cost < bestCost) {
      bestCost = cost;
      best = kept;
    }
    if (kept < count)
      before += binomialCost(checkpoints->start(kept) - start, left);
  }
  return best;
}

Status Rematerialiser::replay(Launch &launch) {
  Status status;
  for (size_t i = 0; i < recording.size() && status; ++i) {
    auto record = static_cast<uint32_t>(i);
    checkpoints->reach(record);
    status = recompute(launch, i, /*saving=*/false, 0);
    topology.settle(record);
    if (recording[i].kernel)
      topology.noteLoops(record, launch.loops);
  }
  executed = 0;
  executedAt.clear();
  return status;
}

Status Rematerialiser::sweep() {
  if (services.isForward() && checkpoints->lackTangents())
    return TapeMemory::failWithoutTangents();
  if (recording.empty())
    return Status::success();
  if (memory.lostChanges())
    return Status::failure(
        StatusCode::Usage,
        "launches that were made while the tape was suspended cannot be "
        "recomputed; record a host function that makes them");
  int64_t leaf = 0;
  for (size_t i = 0; i < recording.size(); ++i)
    leaf = std::max(leaf, memory.mostBytes(static_cast<uint32_t>(i),
                                           static_cast<uint32_t>(i + 1)));
  Status status = checkpoints->checkBudget(leaf);
  if (!status)
    return status;
  // Until the final contents of memory are saved, nothing has been changed, so
  // a failure can simply return.
  status = checkpoints->keepFinal();
  if (!status)
    return status;
  HeldLaunch launch(services);
  try {
    if (sweptBefore)
      status = recomputeAll(launch.get());
    sweptBefore = true;
    memory.notePeak();
    if (status)
      status = reverseAll(launch.get());
  } catch (...) {
    checkpoints->restoreFinal();
    throw;
  }
  checkpoints->restoreFinal();
  // All snapshots are merged into the first one, which covers all records; also
  // after a failure.
  while (checkpoints->count() > 1)
    checkpoints->pop();
  return status;
}

/// Runs the recorded sequence again, with new snapshots, if an earlier sweep
/// has left only the first snapshot.
Status Rematerialiser::recomputeAll(Launch &launch) {
  Status status = checkpoints->restore();
  if (!status)
    return status;
  checkpoints->rewind();
  for (size_t i = 0; i < recording.size() && status; ++i) {
    checkpoints->reach(static_cast<uint32_t>(i));
    status = recompute(launch, i, /*saving=*/false, 0);
  }
  return status;
}

/// Reverses the records between adjacent snapshots, from last to first.
Status Rematerialiser::reverseAll(Launch &launch) {
  int64_t kept =
      checkpoints->chosenPolicy().kind == CheckpointPolicy::Kind::Binomial
          ? bestSnapshots()
          : checkpoints->count();
  Status status;
  while (checkpoints->count() > kept && status) {
    status = checkpoints->restore();
    checkpoints->pop();
  }
  for (size_t end = recording.size(); status;) {
    size_t from = checkpoints->topStart();
    status = checkpoints->restore();
    if (status)
      status = reverseRange(launch, from, end);
    if (checkpoints->count() == 1 || !status)
      break;
    status = checkpoints->restore();
    checkpoints->pop();
    end = from;
  }
  return status;
}

void Rematerialiser::addTo(TapeStats &stats) const {
  if (!checkpoints)
    return;
  stats.savedBytes += checkpoints->bytes();
  stats.snapshots = checkpoints->mostSnapshots();
  stats.snapshotBytes = checkpoints->snapshotBytes();
  stats.recomputed = executed;
  stats.optimum = binomialCost(static_cast<int64_t>(recording.size()),
                               std::max<int64_t>(stats.snapshots, 1));
}
