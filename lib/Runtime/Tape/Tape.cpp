//===- Tape.cpp - Recorded launches and their reverse replay --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The operations of a tape after recording: coordinates its parts.
//
//===----------------------------------------------------------------------===//

#include "TapeParts.h"
#include "tai/Runtime/Mirror/OwedZeros.h"
#include <algorithm>
#include <new>

using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Fields and losses
//===----------------------------------------------------------------------===//

bool Tape::needsValues(const Field &field) const {
  return parts->memory.needsValues(field);
}

bool Tape::uses(const FieldPtr &field) const { return parts->holds.has(field); }

void Tape::releaseFields() { parts->holds.release(); }

namespace {
/// Releases the fields of a tape at the end of a scope, also after a failure.
class ReleasedAtEnd {
public:
  explicit ReleasedAtEnd(Tape &tape) : tape(tape) {}
  ~ReleasedAtEnd() { tape.releaseFields(); }
  ReleasedAtEnd(const ReleasedAtEnd &) = delete;
  ReleasedAtEnd &operator=(const ReleasedAtEnd &) = delete;

private:
  Tape &tape;
};
} // namespace

Status Tape::clearGradients() {
  ReleasedAtEnd releasing(*this);
  Status status = parts->holds.hold();
  return status ? parts->services.owner().gradients().clear(this)
                : std::move(status);
}

Status Tape::addLoss(FieldPtr loss) {
  return parts->seeds.add(std::move(loss), parts->holds);
}

Status Tape::want(const std::vector<FieldPtr> &fields) {
  if (!parts->recording.empty() || !recording())
    return Status::failure(StatusCode::Usage,
                           "the gradients that a tape is for are named before "
                           "it records");
  for (const FieldPtr &field : fields)
    if (!field->adjoint())
      return Status::failure(StatusCode::Usage, "the field '" + field->name() +
                                                    "' has no adjoint field");
  parts->wanted = fields;
  return Status::success();
}

Status Tape::setSeed(const Field &loss, const void *array) {
  return parts->seeds.set(loss, array);
}

Status Tape::findLoops(Kernel &kernel, LoopLists &lists, bool &found) {
  found = true;
  return parts->reverse.findLoops(kernel, lists);
}

//===----------------------------------------------------------------------===//
// Replay
//===----------------------------------------------------------------------===//

bool Tape::planHolds(bool cleared) const {
  return parts->plan.holds(parts->recording, parts->services.epoch(),
                           parts->seeds.liveFields(cleared, parts->holds));
}

void Tape::plan(bool cleared) {
  parts->plan.make(parts->services, parts->recording,
                   parts->seeds.liveFields(cleared, parts->holds),
                   parts->wanted);
}

namespace {
/// While an object lives, the launches of this thread on a device are collected
/// into one piece of work.
class CollectedWork {
public:
  explicit CollectedWork(Runtime &runtime, bool isReplay = false)
      : device(runtime.devices().get()) {
    if (device)
      device->beginCollecting(isReplay);
  }
  ~CollectedWork() { (void)finish(Status::success()); }
  CollectedWork(const CollectedWork &) = delete;
  CollectedWork &operator=(const CollectedWork &) = delete;

  /// Queues the collected work. Returns `status` if it is a failure, else the
  /// result of queueing the work.
  Status finish(Status status) {
    if (!device)
      return status;
    Status ended = device->endCollecting();
    device = nullptr;
    return status ? std::move(ended) : std::move(status);
  }

private:
  DeviceContext *device;
};
} // namespace

Status Tape::backward() {
  ReleasedAtEnd releasing(*this);
  return unlessSpoilt([&] {
    end(/*isSwept=*/true);
    Status status = parts->holds.hold();
    if (status) {
      CollectedWork work(parts->services.owner());
      status = work.finish(sweep());
    }
    return status;
  });
}

Status Tape::replay(bool forward, bool reverse) {
  Runtime &runtime = parts->services.owner();
  if (runtime.recordings().current())
    return Status::failure(StatusCode::Usage,
                           "a tape cannot be replayed while one is being "
                           "recorded");
  // A replay calls kernels without counting what they write.
  runtime.launcher().noteUnknownWrites();
  ReleasedAtEnd releasing(*this);
  return unlessSpoilt([&] {
    Status status = parts->holds.hold();
    if (status) {
      CollectedWork work(runtime, /*isReplay=*/true);
      status = work.finish(replayAll(forward, reverse));
    }
    return status;
  });
}

Status Tape::replayAll(bool forward, bool reverse) {
  Runtime &runtime = parts->services.owner();
  Status status;
  if (reverse)
    status = runtime.gradients().clear(this);
  else
    runtime.settleZeros([this](const FieldPtr &field) { return uses(field); });
  if (forward && status) {
    parts->seeds.clearSums();
    parts->isHalfRun = true;
    status = replayForward();
    parts->isHalfRun = !status;
  }
  return reverse && status ? sweep() : std::move(status);
}

Status Tape::replayForward() {
  Parts &tape = *parts;
  // All launches get new numbers, on which random numbers depend, at the same
  // distances as before.
  tape.recording.renumber(
      tape.services.takeLaunches(tape.recording.numLaunches()));
  HeldLaunch launch(tape.services);
  tape.memory.restart();
  tape.topology.restart();
  tape.rematerialiser.restart();
  Status status;
  if (tape.isDirect() && tape.direct.findForward())
    status = tape.direct.runForward(launch.get());
  else if (tape.rematerialiser.isOn())
    status = tape.rematerialiser.replay(launch.get());
  else
    status = ForwardReplay(tape.services, tape.recording, tape.memory,
                           tape.topology, launch.get())
                 .run();
  tape.topology.end();
  tape.changes.begin(tape.memory);
  return status;
}

Status Tape::sweep() {
  end();
  Parts &tape = *parts;
  if (tape.isHalfRun)
    return Status::failure(StatusCode::Usage,
                           "the last replay of this tape did not reach its "
                           "end, so that the fields do not hold its values; "
                           "replay it again");
  tape.health.clear();
  std::vector<std::string> &notes = tape.report.notes;
  notes.clear();
  tape.services.owner().gradients().settleForSweep(
      [this](const FieldPtr &field) { return uses(field); });
  bool lostStored = false;
  Status status = tape.topology.check();
  if (status) {
    status = tape.changes.check(tape.memory, notes, lostStored);
    tape.forms.setLostStored(lostStored);
  }
  if (status)
    status = tape.seeds.store();
  if (status)
    status = tape.memory.beginReverse();
  if (!status)
    return status;
  tape.topology.beginReverse();
  if (LostGradients::mayHave(tape.recording))
    tape.lost.find(tape.services, tape.recording,
                   tape.seeds.liveFields(false, tape.holds), notes);
  bool isOutOfMemory = false;
  const SkipCounters &counters = tape.services.owner().skipCounters();
  int64_t visited = counters.get(SkipCount::FlaggedVisited);
  int64_t skipped = counters.get(SkipCount::FlaggedSkipped);
  try {
    status = runPlan();
  } catch (...) {
    // Fields hold values of earlier records at this point, so they are restored
    // before the exception goes on.
    isOutOfMemory = true;
  }
  tape.first.end(isOutOfMemory || !status);
  // Fields may hold numbers that a failed sweep has put there.
  if (isOutOfMemory || !status)
    tape.services.owner().launcher().noteUnknownWrites();
  tape.report.noteZeroAdjoints(
      counters.get(SkipCount::FlaggedVisited) - visited,
      counters.get(SkipCount::FlaggedSkipped) - skipped);
  if (!tape.rematerialiser.isOn())
    tape.memory.endReverse();
  tape.topology.endReverse(notes);
  if (isOutOfMemory)
    throw std::bad_alloc();
  for (const auto &[adjoint, zeros] : tape.plan.zerosAfter())
    tape.services.oweZeros(adjoint, zeros);
  forgetUnwanted();
  // Host functions of the sweep can have changed any field: detect changes of
  // fields from here on.
  tape.changes.begin(tape.memory);
  if (status)
    tape.report.checkEffect(tape.recording, tape.plan, tape.seeds.names(),
                            !tape.wanted.empty());
  return status;
}

/// Zeroes the gradients of fields that nobody asked for, to which the sweep has
/// added as intermediate results.
void Tape::forgetUnwanted() {
  const Parts &tape = *parts;
  if (tape.wanted.empty())
    return;
  for (const FieldPtr &field : tape.services.fields()) {
    const FieldPtr &adjoint = field->sharedAdjoint();
    if (!adjoint || !adjoint->valid() || !adjoint->dirty() ||
        !tape.holds.has(adjoint) || tape.seeds.has(*field) ||
        std::find(tape.wanted.begin(), tape.wanted.end(), field) !=
            tape.wanted.end())
      continue;
    if (adjoint->sparseNode()) {
      const char zeros[8] = {};
      adjoint->settleZeros();
      tape.services.perform({HostWrite::What::Fill, adjoint.get(), zeros});
      continue;
    }
    auto zeros = std::make_shared<OwedZeros>();
    zeros->boxes.push_back(
        {std::vector<int64_t>(adjoint->shape().size()), adjoint->shape()});
    tape.services.oweZeros(adjoint, std::move(zeros));
  }
}

Status Tape::runPlan() {
  Parts &tape = *parts;
  bool decides = tape.recording.callsInReverse();
  if (decides || tape.rematerialiser.isOn() || !planHolds())
    plan();
  tape.first.begin(!decides && !tape.rematerialiser.isOn() &&
                   !tape.health.isWatching() && !tape.services.isForward());
  if (tape.rematerialiser.isOn())
    return tape.rematerialiser.sweep();
  HeldLaunch launch(tape.services);
  if (decides)
    return tape.reverse.runDeciding(launch.get());
  int64_t unwanted = tape.plan.numUnwanted();
  tape.services.count(SkipCount::UnwantedLaunches, unwanted);
  tape.services.count(SkipCount::TapeSkipped,
                      numRecords() - unwanted -
                          static_cast<int64_t>(tape.plan.replayed().size()));
  if (tape.isDirect() && tape.direct.findReverse(tape.plan, tape.forms))
    return tape.direct.runReverse(launch.get(), tape.plan, tape.first);
  return tape.reverse.runPlanned(launch.get());
}

Status Tape::runRecord(int64_t index) {
  if (index < 0 || index >= numRecords())
    return Status::failure(StatusCode::Usage,
                           "the tape has no record " + std::to_string(index));
  if (recording())
    return Status::failure(StatusCode::Usage,
                           "a record cannot be launched again while its tape "
                           "records");
  const TapeRecording &records = parts->recording;
  const TapeRecording::Record &record = records[static_cast<size_t>(index)];
  auto *other =
      static_cast<Tape *>(parts->services.owner().recordings().current());
  if (record.kind == TapeRecording::Kind::Write)
    return parts->services.change(records.write(record));
  if (!record.kernel) {
    const TapeCallback &callback = records.callback(record);
    if (other)
      other->suspend();
    Status status = callback.forward ? callback.forward() : Status::success();
    if (other) {
      (void)other->resume();
      if (status)
        other->recordCallback(callback);
    }
    return status;
  }
  Kernel &kernel = *record.kernel;
  const uint64_t *args = records.args(record);
  uint64_t number = records.number(record);
  HeldLaunch launch(parts->services);
  std::vector<uint64_t> results(kernel.resultSlots());
  kernel.setLastLaunch(number);
  uint64_t *wanted = results.empty() ? nullptr : results.data();
  return other
             ? other->launch(launch.get(), kernel, args, wanted, number)
             : parts->services.run(launch.get(), kernel, args, wanted, number);
}

//===----------------------------------------------------------------------===//
// Queries
//===----------------------------------------------------------------------===//

int64_t Tape::numRecords() const {
  return static_cast<int64_t>(parts->recording.size());
}

const Kernel *Tape::kernelOf(int64_t record) const {
  return parts->recording[static_cast<size_t>(record)].kernel;
}

const uint64_t *Tape::argsOf(int64_t record) const {
  return parts->recording.args(parts->recording[static_cast<size_t>(record)]);
}

int64_t Tape::numSkipped() {
  if (!parts->plan.isMade(parts->recording))
    plan();
  return parts->plan.numSkipped();
}

std::vector<PendingAdjoint> Tape::pendingAdjoints(bool cleared) {
  if (!planHolds(cleared))
    plan(cleared);
  return parts->forms.pending();
}

const std::string &Tape::explain() {
  Parts &tape = *parts;
  if (!tape.plan.isMade(tape.recording))
    plan();
  tape.report.begin();
  auto reason = tape.runReasons.begin(), end = tape.runReasons.end();
  for (size_t i = 0; i < tape.recording.size(); ++i) {
    const RunReason *ran = nullptr;
    for (; reason != end && reason->first <= i; ++reason)
      ran = &reason->second;
    tape.report.addRecord(tape.recording, tape.plan, tape.forms, i,
                          tape.memory.bytesAt(static_cast<uint32_t>(i)),
                          tape.rematerialiser.countAt(i), ran);
  }
  if (tape.isDirect() && tape.direct.findForward())
    tape.report.addDirect(tape.recording.size(), "launches");
  if (planHolds(/*cleared=*/true) && tape.isDirect() &&
      tape.direct.findReverse(tape.plan, tape.forms))
    tape.report.addDirect(tape.plan.replayed().size(), "adjoints");
  tape.report.addZeroAdjoints();
  tape.report.addFirstStores(tape.first.names(), tape.first.bytes());
  // Reports the ways in which a device runs the sequences of launches.
  if (const DeviceQueue *queue = tape.services.owner().devices().queue())
    tape.report.add(queue->explain());
  return tape.report.get();
}

TapeStats Tape::stats() const {
  TapeStats stats;
  stats.savedBytes = parts->memory.savedBytes();
  stats.peakBytes = parts->memory.peakBytes();
  parts->rematerialiser.addTo(stats);
  return stats;
}

std::vector<FieldOverwrite> Tape::overwrites() const {
  return parts->recording.overwrites();
}

const std::vector<std::string> &Tape::warnings() const {
  return parts->report.notes;
}

void Tape::watchHealth(bool on) { parts->health.watch(on); }

const std::vector<RecordHealth> &Tape::health() const {
  return parts->health.found();
}
