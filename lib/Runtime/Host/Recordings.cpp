//===- Recordings.cpp - The tapes of several threads ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Host/Recordings.h"
#include <algorithm>
#include <utility>

using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Threads that record, and threads in forward mode
//===----------------------------------------------------------------------===//

static uint64_t nextVersion() {
  static std::atomic<uint64_t> last{0};
  return 1 + last.fetch_add(1, std::memory_order_relaxed);
}

Recorder *Recordings::find() const {
  struct Seen {
    uint64_t version = 0;
    Recorder *tape = nullptr;
  };
  static thread_local Seen seen;
  if (seen.version != version.load(std::memory_order_acquire)) {
    std::lock_guard<std::mutex> lock(mutex);
    seen = {version.load(std::memory_order_relaxed), nullptr};
    for (const Recording &recording : recordings)
      if (recording.thread == threadNumber())
        seen.tape = recording.tape;
  }
  return seen.tape;
}

void Recordings::begin(Recorder &tape) {
  {
    std::lock_guard<std::mutex> lock(mutex);
    recordings.push_back({threadNumber(), &tape});
    if (recordings.size() > 1)
      together = true;
    version.store(nextVersion(), std::memory_order_release);
    ++numRecording;
  }
  state.beginSpecial();
  publishState();
}

void Recordings::end(Recorder &tape) {
  {
    std::lock_guard<std::mutex> lock(mutex);
    recordings.erase(std::find_if(
        recordings.begin(), recordings.end(),
        [&](const Recording &recording) { return recording.tape == &tape; }));
    if (recordings.empty())
      together = false;
    version.store(nextVersion(), std::memory_order_release);
    --numRecording;
  }
  state.endSpecial();
}

std::shared_ptr<const KnownPlan> Recordings::knownPlan() const {
  std::lock_guard<std::mutex> lock(tapesMutex);
  return lastPlan;
}

void Recordings::setKnownPlan(std::shared_ptr<const KnownPlan> plan) {
  std::lock_guard<std::mutex> lock(tapesMutex);
  lastPlan.swap(plan);
}

std::shared_ptr<KnownRuns> Recordings::knownRuns() const {
  std::lock_guard<std::mutex> lock(tapesMutex);
  return runs;
}

void Recordings::setKnownRuns(std::shared_ptr<KnownRuns> made) {
  std::lock_guard<std::mutex> lock(tapesMutex);
  runs.swap(made);
}

void Recordings::add(Recorder &tape) {
  std::lock_guard<std::mutex> lock(tapesMutex);
  tapes.push_back(&tape);
  numTapes.store(tapes.size(), std::memory_order_relaxed);
}

void Recordings::remove(Recorder &tape) {
  std::lock_guard<std::mutex> lock(tapesMutex);
  tapes.erase(std::find(tapes.begin(), tapes.end(), &tape));
  numTapes.store(tapes.size(), std::memory_order_relaxed);
}

bool Recordings::needsValues(const Field &field) const {
  std::lock_guard<std::mutex> lock(tapesMutex);
  return std::any_of(tapes.begin(), tapes.end(), [&](const Recorder *tape) {
    return tape->needsValues(field);
  });
}

Recordings::ReverseFunction::ReverseFunction(Recordings &recordings,
                                             Recorder &tape)
    : recordings(recordings), outer(std::exchange(recordings.sweeper, &tape)),
      outerThread(recordings.sweepThread.exchange(__builtin_thread_pointer())) {
}

Recordings::ReverseFunction::~ReverseFunction() {
  recordings.sweeper = outer;
  recordings.sweepThread = outerThread;
}

/// The recordings for which this thread is in forward mode.
static thread_local const Recordings *forwardOn = nullptr;

bool Recordings::isForwardHere() const { return forwardOn == this; }

void Recordings::setForward(bool on) {
  if (on == isForwardHere())
    return;
  forwardOn = on ? this : nullptr;
  numForward += on ? 1 : -1;
  if (on)
    state.beginSpecial();
  else
    state.endSpecial();
}

//===----------------------------------------------------------------------===//
// Holds
//===----------------------------------------------------------------------===//

void Recordings::beginHolding() {
  ++numHolding;
  state.beginSpecial();
  publishState();
}

void Recordings::endHolding() {
  --numHolding;
  state.endSpecial();
}

static bool agree(HoldKind a, HoldKind b) {
  return a == b && a != HoldKind::Write;
}

/// The verb that messages use for a kind of hold, such as "changes".
static const char *nameOf(HoldKind kind) {
  switch (kind) {
  case HoldKind::Read:
    return "reads";
  case HoldKind::Add:
    return "adds to";
  case HoldKind::Write:
    return "changes";
  }
  __builtin_unreachable();
}

Status Recordings::describe(const Field &field, HoldKind kind,
                            const Hold &other) const {
  return Status::failure(
      StatusCode::Usage,
      "another thread records a tape that " + std::string(nameOf(other.kind)) +
          " " + store.describe(field) + ", which this thread " + nameOf(kind) +
          ": give each thread fields of its own, or begin with the one when "
          "the gradient of the other is there");
}

Status Recordings::checkRunning(const Field &field, HoldKind kind) {
  bool isSparse = field.sparseNode() && field.valid();
  Status status;
  launches->visitChanges([&](const std::string &kernel, const Field &changed,
                             HoldKind other) {
    // A change of activity affects all sparse fields of a tree.
    bool isMet = &changed == &field ? !agree(other, kind)
                                    : isSparse && changed.sparseNode() &&
                                          &changed.tree() == &field.tree();
    if (!isMet || !status)
      return;
    status = Status::failure(
        StatusCode::Usage,
        "another thread runs kernel '" + kernel + "', which " + nameOf(other) +
            " " + store.describe(changed) + ", while a tape of this thread " +
            nameOf(kind) + " " + (isSparse ? "its tree" : "it") +
            ": give each thread fields of its own, or wait until the kernel "
            "has returned");
  });
  return status;
}

Status Recordings::hold(const Recorder &tape, Field &field, HoldKind kind) {
  if (Status status = noteHold(tape, field, kind); !status)
    return status;
  if (__builtin_expect(!launches || !launches->areAny(), true))
    return Status::success();
  // After this fence, launches that begin on other threads see the hold.
  // Launches that already run are checked after it.
  std::atomic_thread_fence(std::memory_order_seq_cst);
  Status status = checkRunning(field, kind);
  if (!status)
    release(tape, field);
  return status;
}

Status Recordings::noteHold(const Recorder &tape, Field &field, HoldKind kind) {
  uint64_t self = threadNumber();
  std::lock_guard<std::mutex> lock(mutex);
  Hold *own = nullptr;
  bool isShared = false;
  for (Hold &hold : field.holds.all) {
    if (hold.tape == &tape)
      own = &hold;
    else if (hold.thread != self && !agree(hold.kind, kind))
      return describe(field, kind, hold);
    isShared |= hold.thread != self;
  }
  if (own)
    *own = {&tape, self, kind};
  else
    field.holds.all.push_back({&tape, self, kind});
  field.holds.holder.store(isShared ? FieldHolds::kManyThreads : self,
                           std::memory_order_release);
  return Status::success();
}

void Recordings::release(const Recorder &tape, Field &field) {
  std::lock_guard<std::mutex> lock(mutex);
  uint64_t holder = 0;
  for (size_t i = 0; i < field.holds.all.size();) {
    const Hold &hold = field.holds.all[i];
    if (hold.tape == &tape) {
      field.holds.all.erase(field.holds.all.begin() +
                            static_cast<ptrdiff_t>(i));
      continue;
    }
    holder = holder == 0 || holder == hold.thread ? hold.thread
                                                  : FieldHolds::kManyThreads;
    ++i;
  }
  field.holds.holder.store(holder, std::memory_order_release);
}

Status Recordings::check(const Field &field, HoldKind kind) const {
  uint64_t holder = field.holds.holder.load(std::memory_order_acquire);
  if (__builtin_expect(holder == 0 || holder == threadNumber(), true))
    return Status::success();
  std::lock_guard<std::mutex> lock(mutex);
  for (const Hold &hold : field.holds.all)
    if (hold.thread != threadNumber() && !agree(hold.kind, kind))
      return describe(field, kind, hold);
  return Status::success();
}

Status Recordings::checkActivity(const Tree &tree) const {
  FieldPtr first = store.firstOf(tree);
  return first ? check(*first, HoldKind::Write) : Status::success();
}
