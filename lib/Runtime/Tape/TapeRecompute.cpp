//===- TapeRecompute.cpp - Reverse sweeps that recompute values -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// With a checkpoint policy, a tape keeps snapshots while it records and nothing
// else. The reverse sweep goes from one to the one before: it runs the records
// in between again, and saves what they overwrite only there. Where even that
// is too much, it takes more snapshots on the way, where the binomial schedule
// (Griewank and Walther, "revolve") wants them.
//
//===----------------------------------------------------------------------===//

#include "../Host/HostWrite.h"
#include "../Launch/Launch.h"
#include "TapeCheckpoint.h"
#include "TapeMemory.h"
#include "TapeTopology.h"
#include "TapeWrite.h"
#include <algorithm>

using namespace mlir::tai::runtime;

Status Tape::setCheckpoints(CheckpointPolicy policy) {
  if (!records.empty() || !recording())
    return Status::failure(StatusCode::Usage,
                           "how a tape keeps values is decided before it "
                           "records");
  if (policy.kind != CheckpointPolicy::Kind::None && runtime.isForward())
    return Status::failure(
        StatusCode::Usage,
        "a tape that recomputes values cannot be recorded in "
        "forward mode: snapshots hold no tangents");
  if (policy.snapshots < 0 || policy.budget < 0)
    return Status::failure(StatusCode::Usage,
                           "the number of snapshots and the memory budget of a "
                           "tape must be positive");
  checkpoints.reset();
  if (policy.kind != CheckpointPolicy::Kind::None)
    checkpoints = std::make_unique<Checkpoints>(runtime, policy);
  memory->useCheckpoints(checkpoints.get());
  return Status::success();
}

/// Calls body(track, slab) for all that the record may change.
template <typename Body>
Status Tape::forEachChange(size_t index, const Body &body) {
  const Record &record = records[index];
  if (record.kind == Kind::Launch) {
    const uint64_t *args = slots.data() + record.payload;
    for (const TapeMemory::Use &use : memory->usesOf(*record.kernel).changes) {
      Status status = body(*use.track, use.locate(args));
      if (!status)
        return status;
    }
    return Status::success();
  }
  const std::vector<TapeMemory::Part> &changes = memory->partsAt(index);
  for (const TapeMemory::Part &part : changes) {
    Status status = body(*part.track, part.slab);
    if (!status)
      return status;
  }
  return Status::success();
}

/// Runs what the record stands for, with the random numbers that it had.
Status Tape::runAgain(Launch &launch, size_t index) {
  const Record &record = records[index];
  uint64_t number = firstLaunch + record.launch;
  switch (record.kind) {
  case Kind::Launch:
    return runtime.run(launch, *record.kernel, slots.data() + record.payload,
                       nullptr, number);
  case Kind::Write:
    if (Status status = runtime.activateFor(getWrite(record)); !status)
      return status;
    runtime.perform(getWrite(record));
    return Status::success();
  case Kind::Callback:
    break;
  }
  const TapeCallback &callback = callbacks[record.payload];
  if (!callback.forward)
    return memory->partsAt(index).empty()
               ? Status::success()
               : Status::failure(StatusCode::Usage,
                                 "record " + std::to_string(index) +
                                     " of the tape is a host function that "
                                     "cannot be run again, which recomputing "
                                     "needs");
  uint64_t next = runtime.launcher().numbers().exchange(number);
  Status status = callback.forward();
  runtime.launcher().numbers().store(next);
  return status;
}

Status Tape::recompute(Launch &launch, size_t index, bool saving,
                       size_t oldest) {
  topology->goBefore(static_cast<uint32_t>(index));
  Status status = forEachChange(index, [&](Track &track, int64_t slab) {
    return checkpoints->log(track, slab);
  });
  if (status && saving)
    status = memory->beforeReplay(static_cast<uint32_t>(index),
                                  static_cast<uint32_t>(oldest));
  topology->runsAgain(static_cast<uint32_t>(index));
  if (status)
    status = runAgain(launch, index);
  checkpoints->settle();
  memory->settle();
  topology->ranAgain(static_cast<uint32_t>(index));
  ++recomputed;
  recomputedAt.resize(records.size());
  ++recomputedAt[index];
  return status;
}

Status Tape::recomputeRange(Launch &launch, size_t from, size_t to) {
  Status status;
  for (size_t i = from; i < to && status; ++i)
    status = recompute(launch, i, /*saving=*/false, 0);
  return status;
}

/// Whether the sweep has anything to do at the record.
bool Tape::mayNeed(size_t index) const {
  return reverseCallbacks || isReplayed(decisions[index]);
}

/// Goes through [from, to) in reverse by saving what is overwritten there.
/// Memory is that before `from`, and anything afterwards.
Status Tape::reverseSaving(Launch &launch, size_t from, size_t to) {
  memory->beginSegment(static_cast<uint32_t>(from));
  Status status;
  for (size_t i = from; i < to && status; ++i)
    status = recompute(launch, i, /*saving=*/true, from);
  if (status)
    status = memory->beginReverse();
  for (size_t i = to; i-- > from && status;)
    status = reverseRecord(launch, i);
  memory->beginSegment(0);
  return status;
}

int64_t Tape::freeSnapshots() const {
  const CheckpointPolicy &policy = checkpoints->getPolicy();
  if (policy.budget > 0)
    return (policy.budget - checkpoints->bytes() - checkpoints->growth()) /
               std::max<int64_t>(checkpoints->snapshotBytes(), 1) -
           1; // the values of the record that is being reversed
  return std::max<int64_t>(policy.snapshots, 1) - checkpoints->count();
}

bool Tape::isShort(size_t from, size_t to) const {
  const CheckpointPolicy &policy = checkpoints->getPolicy();
  if (to - from == 1 || policy.kind == CheckpointPolicy::Kind::Periodic)
    return true;
  if (policy.kind != CheckpointPolicy::Kind::Mixed)
    return false;
  int64_t room = policy.budget > 0 ? policy.budget - checkpoints->bytes() -
                                         checkpoints->growth()
                                   : checkpoints->snapshotBytes();
  return memory->mostBytes(static_cast<uint32_t>(from),
                           static_cast<uint32_t>(to)) <= room;
}

/// Goes through [from, to) in reverse. Memory is that before `from`, where the
/// topmost snapshot is, and anything afterwards.
Status Tape::reverseRange(Launch &launch, size_t from, size_t to) {
  Status status;
  while (status) {
    while (to > from && !mayNeed(to - 1))
      --to;
    if (to == from)
      return status;
    if (isShort(from, to))
      return reverseSaving(launch, from, to);
    int64_t free = freeSnapshots();
    if (free <= 0) {
      // From this one snapshot again and again.
      status = recomputeRange(launch, from, to - 1);
      if (status)
        status = reverseSaving(launch, to - 1, to);
      --to;
      checkpoints->restore();
      continue;
    }
    size_t middle = from + static_cast<size_t>(binomialSplit(
                               static_cast<int64_t>(to - from), free + 1));
    status = recomputeRange(launch, from, middle);
    if (!status)
      return status;
    checkpoints->push(static_cast<uint32_t>(middle));
    status = reverseRange(launch, middle, to);
    checkpoints->restore();
    checkpoints->pop();
    checkpoints->restore();
    to = middle;
  }
  return status;
}

/// How many of the snapshots, from the first on, a sweep should start with: by
/// now their number of records is known, and others may serve better in the
/// places that the later ones take.
int64_t Tape::bestSnapshots() const {
  int64_t count = checkpoints->count();
  int64_t all = count + std::max<int64_t>(freeSnapshots(), 0);
  int64_t best = count, bestCost = INT64_MAX, before = 0;
  for (int64_t kept = 1; kept <= count; ++kept) {
    int64_t left = all - kept + 1;
    int64_t start = checkpoints->start(kept - 1);
    int64_t cost = before + binomialCost(numRecords() - start, left);
    if (cost < bestCost) {
      bestCost = cost;
      best = kept;
    }
    if (kept < count)
      before += binomialCost(checkpoints->start(kept) - start, left);
  }
  return best;
}

Status Tape::sweepRecomputing() {
  if (runtime.isForward())
    return Status::failure(StatusCode::Usage,
                           "a tape that recomputes values cannot be swept in "
                           "forward mode: snapshots hold no tangents");
  plan();
  if (records.empty())
    return Status::success();
  if (memory->lostChanges())
    return Status::failure(
        StatusCode::Usage,
        "launches that were made while the tape was suspended cannot be "
        "recomputed; record a host function that makes them");
  int64_t leaf = 0;
  for (size_t i = 0; i < records.size(); ++i)
    leaf = std::max(leaf, memory->mostBytes(static_cast<uint32_t>(i),
                                            static_cast<uint32_t>(i + 1)));
  Status status = checkpoints->checkBudget(leaf);
  if (!status)
    return status;
  Launch *launch = runtime.acquireLaunch();
  if (sweptBefore) {
    // Only the first snapshot is left.
    checkpoints->restore();
    checkpoints->restart();
    for (size_t i = 0; i < records.size() && status; ++i) {
      checkpoints->reach(static_cast<uint32_t>(i));
      status = recompute(*launch, i, /*saving=*/false, 0);
    }
  }
  sweptBefore = true;
  if (status)
    status = checkpoints->keepFinal();
  memory->notePeak();
  int64_t kept =
      checkpoints->getPolicy().kind == CheckpointPolicy::Kind::Binomial
          ? bestSnapshots()
          : checkpoints->count();
  while (status && checkpoints->count() > kept) {
    checkpoints->restore();
    checkpoints->pop();
  }
  for (size_t end = records.size(); status;) {
    size_t from = checkpoints->topStart();
    checkpoints->restore();
    status = reverseRange(*launch, from, end);
    if (checkpoints->count() == 1)
      break;
    checkpoints->restore();
    checkpoints->pop();
    end = from;
  }
  // After a failure too, the first snapshot covers all.
  while (checkpoints->count() > 1) {
    checkpoints->restore();
    checkpoints->pop();
  }
  checkpoints->restoreFinal();
  runtime.releaseLaunch(launch);
  return status;
}

TapeStats Tape::stats() const {
  TapeStats stats;
  stats.savedBytes = memory->savedBytes();
  stats.peakBytes = memory->peakBytes();
  if (!checkpoints)
    return stats;
  stats.savedBytes += checkpoints->bytes();
  stats.snapshots = checkpoints->mostSnapshots();
  stats.snapshotBytes = checkpoints->snapshotBytes();
  stats.recomputed = recomputed;
  stats.optimum =
      binomialCost(numRecords(), std::max<int64_t>(stats.snapshots, 1));
  return stats;
}
