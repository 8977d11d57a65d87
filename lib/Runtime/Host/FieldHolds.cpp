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

#include "../Launch/Launch.h"
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
  runningLaunches.letLaunchesSee();
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
                 !opts.profiler && !owesZeros();
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

std::string Runtime::describe(const Field &field) const {
  std::lock_guard<std::mutex> lock(fieldsMutex);
  if (field.isAdjoint())
    for (const FieldPtr &primal : fieldList)
      if (primal->adjoint() == &field)
        return "the gradient of field '" + primal->name() + "'";
  return "field '" + field.name() + "'";
}

Status Runtime::describeHold(const Field &field, HoldKind kind,
                             const Hold &other) const {
  return Status::failure(
      StatusCode::Usage,
      "another thread records a tape that " +
          std::string(::describe(other.kind)) + " " + describe(field) +
          ", which this thread " + ::describe(kind) +
          ": give each thread fields of its own, or begin with the one when "
          "the gradient of the other is there");
}

Status Runtime::checkRunning(const Field &field, HoldKind kind) {
  bool isSparse = field.sparseNode() && field.valid();
  Status status;
  runningLaunches.visit([&](const Launch &launch, const Kernel &kernel) {
    if (launch.isOfThisThread() ||
        !launch.isPlain.load(std::memory_order_relaxed))
      return;
    for (const Access &access : kernel.summary()) {
      HoldKind other = getKind(access.kind);
      // What is active is the same for all fields of a tree.
      bool isMet = access.field.get() == &field
                       ? !agree(other, kind)
                       : isSparse && access.field->sparseNode() &&
                             &access.field->tree() == &field.tree();
      if (access.kind == AccessKind::Read || !isMet || !status)
        continue;
      status = Status::failure(
          StatusCode::Usage,
          "another thread runs kernel '" + kernel.name() + "', which " +
              ::describe(other) + " " + describe(*access.field) +
              ", while a tape of this thread " + ::describe(kind) + " " +
              (isSparse ? "its tree" : "it") +
              ": give each thread fields of its own, or wait until the kernel "
              "has returned");
    }
  });
  return status;
}

Status Runtime::hold(const Tape &tape, Field &field, HoldKind kind) {
  if (Status status = noteHold(tape, field, kind); !status)
    return status;
  if (__builtin_expect(!runningLaunches.areOthers(), true))
    return Status::success();
  // What begins from now on sees the hold.
  std::atomic_thread_fence(std::memory_order_seq_cst);
  Status status = checkRunning(field, kind);
  if (!status)
    release(tape, field);
  return status;
}

Status Runtime::noteHold(const Tape &tape, Field &field, HoldKind kind) {
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

FieldPtr Runtime::firstOf(const Tree &tree) const {
  std::lock_guard<std::mutex> lock(fieldsMutex);
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

//===----------------------------------------------------------------------===//
// What a tape uses
//===----------------------------------------------------------------------===//

Status Tape::touch(const FieldPtr &field, HoldKind kind) {
  auto [entry, isNew] = touched.try_emplace(field, kind);
  if (!isNew) {
    if (entry->second == kind || entry->second == HoldKind::Write)
      return Status::success();
    entry->second = HoldKind::Write;
  }
  if (!holding)
    return Status::success();
  Status status = runtime.hold(*this, *field, entry->second);
  if (!status) {
    touched.erase(entry);
    return status;
  }
  // Left there by another thread before: a tape begins with gradients of zero.
  if (isNew && clears && field->isAdjoint() &&
      Runtime::isOfAnotherThread(*field)) {
    const char zeros[8] = {};
    field->settleZeros();
    runtime.perform({HostWrite::What::Fill, field.get(), zeros});
    field->lastWriter.store(0, std::memory_order_relaxed);
  }
  return status;
}

Status Tape::touch(const Kernel &kernel) {
  bool reads = kernel.callerAdjoints().hasTargets;
  bool changes = kernel.callerAdjoints().hasSources();
  Status status;
  for (const Access &access : kernel.summary()) {
    if (status)
      status = touch(access.field, getKind(access.kind));
    // What is active is part of the sequence, and the same for all fields.
    if (status && access.field->sparseNode() && access.field->valid())
      status = touch(runtime.firstOf(access.field->tree()), HoldKind::Write);
    if (access.field->adjoint())
      (access.kind == AccessKind::Read ? reads : changes) = true;
  }
  // A sweep adds to the gradients of what is read, and takes those of what is
  // changed to be of this tape.
  HoldKind kind = clears ? HoldKind::Write : HoldKind::Add;
  if (reads && changes)
    for (const Access &access : kernel.summary())
      if (status && access.field->adjointField)
        status = touch(access.field->adjointField, kind);
  return status;
}

Status Tape::holdFields() {
  if (!holding) {
    holding = true;
    ++runtime.numHolding;
    runtime.updateLaunchState();
    runtime.runningLaunches.letLaunchesSee();
  }
  Status status;
  for (const auto &[field, kind] : touched)
    if (status)
      status = runtime.hold(*this, *field, kind);
  return status;
}

void Tape::releaseFields() {
  if (!holding)
    return;
  holding = false;
  for (const auto &[field, kind] : touched)
    runtime.release(*this, *field);
  --runtime.numHolding;
  runtime.updateLaunchState();
}

Status Tape::clearGradients() {
  Status status = holdFields();
  if (status)
    runtime.clearGradients(this);
  releaseFields();
  return status;
}
