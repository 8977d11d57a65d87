//===- Tape.cpp - Recorded launches and their reverse replay --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The reverse sweep runs by a plan, made once for a sequence of records and a
// set of adjoints that are non-zero at its start. A callback may touch
// anything, so a tape with callbacks decides as it goes, from the dirty flags
// of the adjoint fields, which every launch and every host write keep.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Tape/Tape.h"
#include "../Host/HostWrite.h"
#include "../Launch/Launch.h"
#include "../Mirror/DeviceContext.h"
#include "../Storage/Scalars.h"
#include "../Text/Format.h"
#include "TapeCheckpoint.h"
#include "TapeMemory.h"
#include "TapeTopology.h"
#include <algorithm>
#include <cstring>

using namespace mlir::tai::runtime;

Status Tape::begin(Runtime &runtime, FieldPtr loss, bool clear,
                   std::unique_ptr<Tape> &tape) {
  if (runtime.recordingTape())
    return Status::failure(StatusCode::Usage,
                           "a tape is being recorded already, and tapes do not "
                           "nest");
  // A device recognises recordings that come again by what is queued.
  DeviceContext *device = runtime.getDeviceContext();
  if (device && runtime.recordings().isAny())
    return Status::failure(StatusCode::Usage,
                           "another thread records a tape, and a GPU has room "
                           "for one at a time: let it finish first");
  std::unique_ptr<Tape> made(
      new Tape(runtime, runtime.recordings().nextStamp(), clear));
  // From here on it holds what it uses.
  Status held = made->holdFields();
  if (!held)
    return held;
  if (loss) {
    if (loss->rank() != 0 || loss->numComponents() != 1 ||
        !isFloat(loss->scalar()))
      return Status::failure(StatusCode::Usage,
                             "the loss '" + loss->name() +
                                 "' must be one floating-point number (a field "
                                 "without indices)");
    Status status = made->addLoss(std::move(loss));
    if (!status)
      return status;
  }
  // Clearing belongs to it.
  if (device)
    device->beginRecording();
  if (clear)
    runtime.clearGradients(made.get());
  else
    runtime.settleZeros();
  tape = std::move(made);
  tape->isOpen = true;
  runtime.recordings().begin(*tape);
  return Status::success();
}

//===----------------------------------------------------------------------===//
// What the reverse sweep needs
//===----------------------------------------------------------------------===//

template <typename Live>
Tape::Decision Tape::decide(size_t index, const Live &live) const {
  const Record &record = records[index];
  if (record.kind == Kind::Callback)
    return callbacks[record.payload].backward ? Decision::Callback
                                              : Decision::SkipCallback;
  if (record.kind == Kind::Write) {
    const Field *field = getWrite(record).field;
    return field->adjoint() && live(field) ? Decision::Overwrite
                                           : Decision::SkipUnreached;
  }
  const Kernel &kernel = *record.kernel;
  if (!kernel.differentiable())
    return Decision::SkipNoDerivative;
  const auto &sources = kernel.adjointSources;
  const CallerAdjoints &caller = kernel.info.callerAdjoints;
  if (std::none_of(sources.begin(), sources.end(), live) &&
      !caller.hasSources())
    return Decision::SkipUnreached;
  if (!kernel.adjointTargets.empty() || caller.hasTargets)
    return Decision::Replay;
  // What remains is to forget the adjoints of what the kernel overwrote. That
  // matters only to those who wrote it before.
  if (storesAgain[index] &&
      std::any_of(kernel.overwritten.begin(), kernel.overwritten.end(), live))
    return Decision::Replay;
  return Decision::SkipNoEffect;
}

Tape::Decision Tape::withoutPruning(size_t index, Decision decision) const {
  bool prunes =
      decision == Decision::SkipUnreached || decision == Decision::SkipNoEffect;
  return prunes && records[index].kernel && !runtime.skips(Skip::TapePruning)
             ? Decision::Unpruned
             : decision;
}

std::vector<Field *> Tape::liveFields(bool cleared) const {
  // What another thread has left is no concern of this tape.
  auto mayBeNonzero = [&](const FieldPtr &adjoint) {
    if (adjoint->isDirtiedByOther() && !touched.count(adjoint))
      return false;
    return cleared ? adjoint->tree().isLent() : adjoint->dirty();
  };
  std::vector<Field *> live;
  for (const FieldPtr &field : runtime.fields())
    if (field->adjoint() &&
        (isLoss(*field) || mayBeNonzero(field->adjointField)))
      live.push_back(field.get());
  return live;
}

bool Tape::planHolds(bool cleared) const {
  return decisions.size() == records.size() &&
         plannedEpoch == runtime.storageEpoch() &&
         plannedLive == liveFields(cleared);
}

void Tape::plan(bool cleared) {
  plannedEpoch = runtime.storageEpoch();
  plannedLive = liveFields(cleared);
  decisions.assign(records.size(), Decision::SkipUnreached);
  needed.clear();
  for (const KernelPtr &kernel : kernels)
    // A tree that has gone is an error when the kernel is launched.
    (void)kernel->bind(plannedEpoch);
  findRepeatedStores();

  uint64_t mark = runtime.recordings().nextStamp();
  for (Field *field : plannedLive)
    field->planMark = mark;
  bool all = false;
  auto live = [&](const Field *field) {
    return all || field->planMark == mark;
  };
  for (size_t i = records.size(); i-- > 0;) {
    decisions[i] = withoutPruning(i, decide(i, live));
    if (decisions[i] == Decision::Callback)
      all = true;
    if (isReplayed(decisions[i]))
      needed.push_back(static_cast<uint32_t>(i));
    if (decisions[i] != Decision::Replay)
      continue;
    for (Field *field : records[i].kernel->adjointTargets)
      field->planMark = mark;
  }
}

//===----------------------------------------------------------------------===//
// Replay
//===----------------------------------------------------------------------===//

Status Tape::replayAdjoint(Launch &launch, size_t index) {
  const Record &record = records[index];
  topology->enter(static_cast<uint32_t>(index));
  if (record.kind == Kind::Write)
    return overwrite(getWrite(record));
  if (memory->empty())
    return runAdjoint(launch, index);
  Kernel &kernel = *record.kernel;
  bool changes = kernel.adjointReruns;
  memory->enter(static_cast<uint32_t>(index), changes);
  Status status = runAdjoint(launch, index);
  memory->leave(changes);
  return status;
}

Status Tape::runAdjoint(Launch &launch, size_t index) {
  const Record &record = records[index];
  Kernel &kernel = *record.kernel;
  // A value that was returned and not used any more costs nothing.
  const auto &sources = kernel.adjointSources;
  if (runtime.skips(Skip::TapePruning) &&
      !kernel.info.callerAdjoints.results.empty() &&
      std::none_of(sources.begin(), sources.end(),
                   [](Field *field) { return field->adjoint()->dirty(); }) &&
      kernel.info.callerAdjoints.areZero(slots.data() + record.payload +
                                         kernel.argSlots()))
    return Status::success();
  Kernel *adjoint = nullptr;
  Status status = findAdjoint(index, adjoint);
  // What the loss does not depend on need not be differentiable.
  if (!status && decisions[index] == Decision::Unpruned)
    return Status::success();
  if (!status || !adjoint)
    return status;
  status = checkActivity(index);
  if (!status)
    return status;
  runtime.skipCounters().bump(SkipCount::TapeReplayed);
  static const LoopLists none;
  const LoopLists *loops = topology->loopsAt(static_cast<uint32_t>(index));
  status = runtime.runAdjoint(
      launch, kernel, *adjoint, slots.data() + record.payload,
      firstLaunch + record.launch, loops ? loops : &none);
  if (__builtin_expect(watching, false) && status)
    examine(index);
  return status;
}

/// A launch for as long as a sweep takes.
class Tape::HeldLaunch {
public:
  explicit HeldLaunch(Runtime &runtime)
      : runtime(runtime), launch(runtime.acquireLaunch()) {}
  ~HeldLaunch() { runtime.releaseLaunch(launch); }
  Launch &get() const { return *launch; }

private:
  Runtime &runtime;
  Launch *launch;
};

Status Tape::sweepPlanned() {
  if (!planHolds())
    plan();
  runtime.skipCounters().bump(SkipCount::TapeSkipped,
                              numRecords() -
                                  static_cast<int64_t>(needed.size()));
  HeldLaunch held(runtime);
  if (findPlainReverse())
    return runPlainReverse(held.get());
  for (uint32_t index : needed) {
    Status status = replayAdjoint(held.get(), index);
    if (!status)
      return status;
  }
  return Status::success();
}

Status Tape::reverseRecord(Launch &launch, size_t i) {
  if (reverseCallbacks)
    decisions[i] = withoutPruning(i, decide(i, [](const Field *field) {
                                    return field->adjoint()->dirty();
                                  }));
  Status status;
  if (decisions[i] == Decision::Callback) {
    topology->enter(static_cast<uint32_t>(i));
    memory->enter(static_cast<uint32_t>(i), /*reruns=*/false);
    status = callReverse(i);
    if (status && watching)
      examine(i);
  } else if (isReplayed(decisions[i])) {
    status = replayAdjoint(launch, i);
  } else {
    runtime.skipCounters().bump(SkipCount::TapeSkipped);
  }
  return status;
}

Status Tape::sweepAroundCallbacks() {
  plan();
  HeldLaunch held(runtime);
  Status status;
  for (size_t i = records.size(); i-- > 0 && status;)
    status = reverseRecord(held.get(), i);
  return status;
}

namespace {
/// While it lives, what is launched on a device becomes one piece of work.
class CollectedWork {
public:
  explicit CollectedWork(Runtime &runtime, bool isReplay = false)
      : device(runtime.getDeviceContext()) {
    if (device)
      device->beginCollecting(isReplay);
  }
  ~CollectedWork() { (void)finish(Status::success()); }
  CollectedWork(const CollectedWork &) = delete;
  CollectedWork &operator=(const CollectedWork &) = delete;

  /// Queues it. What has gone wrong before comes first.
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
  end(/*isSwept=*/true);
  Status status = holdFields();
  if (status) {
    CollectedWork work(runtime);
    status = work.finish(sweep());
  }
  releaseFields();
  return status;
}

Status Tape::sweep() {
  end();
  examined.clear();
  notes.clear();
  runtime.settleZeros();
  Status status = topology->check();
  if (status)
    status = checkVersions();
  if (status)
    status = seed();
  if (status)
    status = memory->beginReverse();
  if (!status)
    return status;
  topology->beginReverse();
  noteCuts();
  if (checkpoints)
    status = sweepRecomputing();
  else
    status = reverseCallbacks ? sweepAroundCallbacks() : sweepPlanned();
  if (!checkpoints)
    memory->endReverse();
  topology->endReverse(notes);
  oweZeros();
  // Host functions may have changed what they like.
  markVersions();
  if (status)
    checkEffect();
  return status;
}

Status Tape::runForward() {
  // New numbers for all launches, at the same distances.
  firstLaunch = runtime.launcher().numbers().fetch_add(
      anyLaunch ? lastLaunch + 1 : 0, std::memory_order_relaxed);
  HeldLaunch held(runtime);
  memory->restart();
  topology->restart();
  sweptBefore = false;
  Status status;
  size_t first = 0;
  bool launched = false;
  if (findPlainForward()) {
    status = runPlainForward(held.get());
    first = records.size();
  }
  for (size_t i = first; i < records.size() && status; ++i) {
    const Record &record = records[i];
    if (checkpoints) {
      checkpoints->reach(static_cast<uint32_t>(i));
      status = recompute(held.get(), i, /*saving=*/false, 0);
      topology->settle(static_cast<uint32_t>(i));
      if (record.kernel)
        topology->noteLoops(static_cast<uint32_t>(i), held.get().loops);
      continue;
    }
    status = memory->beforeReplay(static_cast<uint32_t>(i));
    if (!status)
      break;
    launched |= record.kernel != nullptr;
    if (record.kernel) {
      uint64_t number = firstLaunch + record.launch;
      record.kernel->prepared.lastLaunch.store(number,
                                               std::memory_order_relaxed);
      status = runtime.run(held.get(), *record.kernel,
                           slots.data() + record.payload, nullptr, number);
    } else if (record.kind == Kind::Write) {
      HostWrite write = getWrite(record);
      status = runtime.activateFor(write);
      runtime.perform(write);
      // What the host writes is a constant; before the first launch, it is the
      // point at which one differentiates.
      const char zeros[8] = {};
      write.field =
          runtime.isForward() && launched ? write.field->dual() : nullptr;
      write.bytes = zeros;
      if (write.what == HostWrite::What::Array)
        write.what = HostWrite::What::Fill;
      if (write.field)
        runtime.perform(write);
    } else if (callbacks[record.payload].forward) {
      status = callbacks[record.payload].forward();
    }
    memory->settle();
    topology->settle(static_cast<uint32_t>(i));
    if (record.kernel)
      topology->noteLoops(static_cast<uint32_t>(i), held.get().loops);
  }
  topology->end();
  markVersions();
  recomputed = 0;
  recomputedAt.clear();
  return status;
}

Status Tape::replay(bool forward, bool reverse) {
  if (runtime.recordingTape())
    return Status::failure(StatusCode::Usage,
                           "a tape cannot be replayed while one is being "
                           "recorded");
  Status status = holdFields();
  if (status) {
    CollectedWork work(runtime, /*isReplay=*/true);
    status = work.finish(runAgain(forward, reverse));
  }
  releaseFields();
  return status;
}

Status Tape::runAgain(bool forward, bool reverse) {
  if (reverse)
    runtime.clearGradients(this);
  else
    runtime.settleZeros();
  if (forward) {
    for (const Loss &loss : losses)
      if (loss.field->valid())
        clearSum(*loss.field);
    Status status = runForward();
    if (!status)
      return status;
  }
  return reverse ? sweep() : Status::success();
}

//===----------------------------------------------------------------------===//
// What one sees
//===----------------------------------------------------------------------===//

int64_t Tape::numSkipped() {
  if (decisions.size() != records.size())
    plan();
  return std::count_if(
      decisions.begin(), decisions.end(), [](Decision decision) {
        return !isReplayed(decision) && decision != Decision::Callback;
      });
}

std::vector<Tape::Pending> Tape::pendingAdjoints(bool cleared) {
  if (!planHolds(cleared))
    plan(cleared);
  std::vector<Pending> pending;
  for (uint32_t index : needed) {
    // Those that are not pruned need not be differentiable.
    if (!records[index].kernel || decisions[index] == Decision::Unpruned)
      continue;
    Pending entry = {records[index].kernel, storesAgain[index],
                     readsStoredAt(index)};
    const Kernel::AdjointForm &form =
        entry.stored ? entry.kernel->storedForms[entry.takes]
                     : entry.kernel->adjointForms[entry.takes];
    if (!form.known.load(std::memory_order_relaxed) && !form.asked &&
        std::find(pending.begin(), pending.end(), entry) == pending.end())
      pending.push_back(entry);
  }
  return pending;
}

static void appendNames(std::string &text, const std::vector<Field *> &fields) {
  if (fields.empty())
    text += "arrays or returned values";
  for (size_t i = 0; i < fields.size(); ++i)
    text += (i ? ", @" : "@") + fields[i]->name();
}

const std::string &Tape::explain() {
  if (decisions.size() != records.size())
    plan();
  explanation.clear();
  for (size_t i = 0; i < records.size(); ++i) {
    const Record &record = records[i];
    std::string name =
        record.kernel ? "@" + record.kernel->name()
        : record.kind == Kind::Write
            ? "(write of @" + getWrite(record).field->name() + ")"
            : "(host function)";
    explanation += std::to_string(i) + ": " + name + ": ";
    switch (decisions[i]) {
    case Decision::Replay:
      explanation += "replayed, from the adjoints of ";
      appendNames(explanation, record.kernel->adjointSources);
      if (!record.kernel->adjointTargets.empty()) {
        explanation += " to those of ";
        appendNames(explanation, record.kernel->adjointTargets);
      }
      explainStored(i);
      break;
    case Decision::Unpruned:
      explanation += "replayed, without effect: 'tape-pruning' is off";
      break;
    case Decision::SkipNoDerivative:
      explanation += "skipped: it has nothing to differentiate";
      break;
    case Decision::SkipUnreached:
      if (!record.kernel) {
        explanation += "skipped: no adjoint reaches it";
      } else if (record.kernel->adjointSources.empty()) {
        explanation += "skipped: it changes no field that has an adjoint";
      } else {
        explanation += "skipped: no adjoint reaches ";
        appendNames(explanation, record.kernel->adjointSources);
      }
      break;
    case Decision::SkipNoEffect:
      explanation += "skipped: it reads no field that has an adjoint";
      break;
    case Decision::Callback:
      explanation += "called";
      break;
    case Decision::SkipCallback:
      explanation += "skipped: it has no reverse function";
      break;
    case Decision::Overwrite:
      explanation += "ends the adjoints of what it overwrites";
      break;
    }
    if (int64_t bytes = memory->bytesAt(static_cast<uint32_t>(i)))
      explanation += "; saved " + formatBytes(bytes);
    if (i < recomputedAt.size() && recomputedAt[i])
      explanation +=
          "; recomputed " + std::to_string(recomputedAt[i]) + " times";
    explanation += '\n';
  }
  explainPlain();
  // How a device runs sequences of launches.
  if (const DeviceQueue *queue = runtime.getDeviceQueue())
    explanation += queue->explain();
  return explanation;
}

std::vector<Tape::Overwrite> Tape::overwrites() const {
  std::vector<Overwrite> result;
  std::unordered_map<const Field *, int64_t> lastUse;
  for (size_t i = 0; i < records.size(); ++i) {
    if (!records[i].kernel)
      continue;
    const auto &summary = records[i].kernel->summary();
    for (const Access &access : summary) {
      if (access.kind != AccessKind::Write)
        continue;
      auto earlier = lastUse.find(access.field.get());
      if (earlier != lastUse.end())
        result.push_back(
            {static_cast<int64_t>(i), access.field.get(), earlier->second});
    }
    for (const Access &access : summary)
      lastUse[access.field.get()] = static_cast<int64_t>(i);
  }
  return result;
}
