//===- FieldHolds.cpp - Tapes of several threads --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Each thread may record a tape. What a tape uses, it holds: what other threads
// do to such a field meanwhile fails where it would change a gradient; see
// docs/decisions/0022-tapes-of-threads.md.
//
//===----------------------------------------------------------------------===//

#include "../Launch/TangentFlows.h"
#include "HostWrite.h"
#include "tai/Runtime/Launch/Runtime.h"
#include "tai/Runtime/Tape/Tape.h"
#include <algorithm>

using namespace mlir::tai::runtime;

__thread uint64_t mlir::tai::runtime::ownThreadNumber = 0;

uint64_t mlir::tai::runtime::numberThread() {
  static std::atomic<uint64_t> last{0};
  return ownThreadNumber = 1 + last.fetch_add(1, std::memory_order_relaxed);
}

//===----------------------------------------------------------------------===//
// Who records, and who is in forward mode
//===----------------------------------------------------------------------===//

static uint64_t nextVersion() {
  static std::atomic<uint64_t> last{0};
  return 1 + last.fetch_add(1, std::memory_order_relaxed);
}

Tape *Runtime::findRecording() const {
  struct Seen {
    uint64_t version = 0;
    Tape *tape = nullptr;
  };
  static thread_local Seen seen;
  if (seen.version != recordingVersion.load(std::memory_order_acquire)) {
    std::lock_guard<std::mutex> lock(recordingMutex);
    seen = {recordingVersion.load(std::memory_order_relaxed), nullptr};
    for (const Recording &recording : recordings)
      if (recording.thread == threadNumber())
        seen.tape = recording.tape;
  }
  return seen.tape;
}

void Runtime::beginRecording(Tape &tape) {
  {
    std::lock_guard<std::mutex> lock(recordingMutex);
    if (!recordings.empty())
      recordsTogether = true;
    recordings.push_back({threadNumber(), &tape});
    recordingVersion.store(nextVersion(), std::memory_order_release);
    ++numRecording;
  }
  updateLaunchState();
}

void Runtime::endRecording(Tape &tape) {
  {
    std::lock_guard<std::mutex> lock(recordingMutex);
    recordings.erase(std::find_if(
        recordings.begin(), recordings.end(),
        [&](const Recording &recording) { return recording.tape == &tape; }));
    if (recordings.empty())
      recordsTogether = false;
    recordingVersion.store(nextVersion(), std::memory_order_release);
    --numRecording;
  }
  updateLaunchState();
}

/// The runtime for which this thread is in forward mode.
static thread_local const Runtime *forwardOn = nullptr;

bool Runtime::isForwardHere() const { return forwardOn == this; }

void Runtime::setForward(bool on) {
  if (on != isForwardHere())
    numForward += on ? 1 : -1;
  forwardOn = on ? this : nullptr;
  tangentFlows.reset();
  updateLaunchState();
}

void Runtime::updateLaunchState() {
  std::lock_guard<std::mutex> lock(stateMutex);
  bool isPlain = numRecording == 0 && numHolding == 0 && numForward == 0 &&
                 !opts.profiler && owing.empty();
  hot.state.store(isPlain ? storageEpoch.load(std::memory_order_relaxed)
                          : neverPrepared,
                  std::memory_order_relaxed);
}

//===----------------------------------------------------------------------===//
// Holds
//===----------------------------------------------------------------------===//

static bool agree(HoldKind a, HoldKind b) {
  return a == b && a != HoldKind::Write;
}

static HoldKind getKind(AccessKind kind) {
  switch (kind) {
  case AccessKind::Read:
    return HoldKind::Read;
  case AccessKind::Accumulate:
    return HoldKind::Add;
  case AccessKind::Write:
    return HoldKind::Write;
  }
  __builtin_unreachable();
}

/// "changes", for messages.
static const char *describe(HoldKind kind) {
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

Status Runtime::describeHold(const Field &field, HoldKind kind,
                             const Hold &other) const {
  std::string name = "field '" + field.name() + "'";
  if (field.isAdjoint())
    for (const FieldPtr &primal : fieldList)
      if (primal->adjoint() == &field)
        name = "the gradient of field '" + primal->name() + "'";
  return Status::failure(
      StatusCode::Usage,
      "another thread records a tape that " +
          std::string(describe(other.kind)) + " " + name +
          ", which this thread " + describe(kind) +
          ": give each thread fields of its own, or begin with the one when "
          "the gradient of the other is there");
}

Status Runtime::hold(const Tape &tape, Field &field, HoldKind kind) {
  uint64_t self = threadNumber();
  std::lock_guard<std::mutex> lock(recordingMutex);
  Hold *own = nullptr;
  bool isShared = false;
  for (Hold &hold : field.holds) {
    if (hold.tape == &tape)
      own = &hold;
    else if (hold.thread != self && !agree(hold.kind, kind))
      return describeHold(field, kind, hold);
    isShared |= hold.thread != self;
  }
  if (own)
    *own = {&tape, self, kind};
  else
    field.holds.push_back({&tape, self, kind});
  field.holder.store(isShared ? Field::kManyThreads : self,
                     std::memory_order_release);
  return Status::success();
}

void Runtime::release(const Tape &tape, Field &field) {
  std::lock_guard<std::mutex> lock(recordingMutex);
  uint64_t holder = 0;
  for (size_t i = 0; i < field.holds.size();) {
    const Hold &hold = field.holds[i];
    if (hold.tape == &tape) {
      field.holds.erase(field.holds.begin() + static_cast<ptrdiff_t>(i));
      continue;
    }
    holder = holder == 0 || holder == hold.thread ? hold.thread
                                                  : Field::kManyThreads;
    ++i;
  }
  field.holder.store(holder, std::memory_order_release);
}

Status Runtime::checkHold(const Field &field, HoldKind kind) const {
  uint64_t holder = field.heldBy();
  if (__builtin_expect(holder == 0 || holder == threadNumber(), true))
    return Status::success();
  std::lock_guard<std::mutex> lock(recordingMutex);
  for (const Hold &hold : field.holds)
    if (hold.thread != threadNumber() && !agree(hold.kind, kind))
      return describeHold(field, kind, hold);
  return Status::success();
}

Status Runtime::checkHolds(const Kernel &kernel) {
  Status status;
  for (const Access &access : kernel.summary()) {
    if (access.kind == AccessKind::Read)
      continue;
    if (status)
      status = checkHold(*access.field, getKind(access.kind));
    if (status && access.field->sparseNode() && access.field->valid())
      status = checkHold(*firstOf(access.field->tree()), HoldKind::Write);
  }
  return status;
}

const FieldPtr &Runtime::firstOf(const Tree &tree) const {
  return *std::find_if(
      fieldList.begin(), fieldList.end(),
      [&](const FieldPtr &field) { return &field->tree() == &tree; });
}

Status Runtime::checkAdjointHolds(const Kernel &kernel) {
  Status status;
  for (const std::vector<Field *> &fields :
       {kernel.adjointTargets, kernel.adjointSources})
    for (Field *field : fields)
      if (status)
        status = checkHold(*field->adjoint(), HoldKind::Write);
  return status;
}

bool Runtime::isOfAnotherThread(const Field &adjoint) {
  uint64_t writer = adjoint.dirtiedBy();
  return writer != 0 && writer != threadNumber();
}
