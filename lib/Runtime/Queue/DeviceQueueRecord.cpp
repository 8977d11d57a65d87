//===- DeviceQueueRecord.cpp - When work is collected ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Replays and sweeps are collected as a whole. A recording is collected if the
// same launches were recorded before, together with a sweep that follows at
// once: both then run as the program of a replay. An operation that cannot wait
// until the recording ends first queues the collected work, in order. Launches
// between two replays are deferred to the second one.
//
//===----------------------------------------------------------------------===//

#include "RecordedLaunches.h"
#include "SequencePrefixes.h"
#include "tai/Runtime/Programs/DeviceProgram.h"
#include "tai/Runtime/Queue/DeviceQueue.h"
#include <algorithm>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::programs;

//===----------------------------------------------------------------------===//
// Replays and sweeps
//===----------------------------------------------------------------------===//

void DeviceQueue::beginCollecting(bool replay) {
  if (collecting++ > 0 || !checkHandler())
    return;
  collection.hasProgram = false;
  failure = Status::success();
  collection.isReplay = replay;
  // The reverse sweep of another tape interrupts a recording that is not
  // collected.
  if (isRecording() && !isGathering())
    (void)recorded->interrupt(/*isEnd=*/true);
  if (isGathering()) {
    bool isWhole = recorded->interrupt(/*isEnd=*/true);
    if (recording == Recording::AwaitsSweep)
      recording = Recording::None;
    // The collected launches of the recording and its reverse sweep become one
    // sequence.
    if (isWhole) {
      collection.isReplay = true;
      return;
    }
    failure = flush(/*isWhole=*/false);
  }
  if (collection.isReplay && watches) {
    prefixes->begin();
  } else {
    (void)noteOther();
    // The deferred launches are queued, but deferred fills are kept for the new
    // sequence.
    if (Status status = runPrefix(); !status)
      failure = std::move(status);
  }
  watches = false;
}

Status DeviceQueue::endCollecting() {
  if (--collecting > 0)
    return Status::success();
  Status status = checkHandler();
  if (!status) {
    // A signal handler must not run the work that it has interrupted.
    *collected = Sequence();
    return status;
  }
  status = flush(/*isWhole=*/true);
  watches = collection.isReplay && collection.hasProgram && !isRecording();
  prefixes->end(watches);
  Status before = std::move(failure);
  failure = Status::success();
  return before ? std::move(status) : std::move(before);
}

bool DeviceQueue::noteOther() {
  if (watches)
    prefixes->interrupt();
  if (!isRecording() || collecting > 0)
    return false;
  if (recording == Recording::AwaitsSweep)
    recording = Recording::None;
  return recorded->interrupt();
}

//===----------------------------------------------------------------------===//
// Recordings
//===----------------------------------------------------------------------===//

bool DeviceQueue::isGathering() const {
  return isRecording() && recorded->isCollecting();
}

Status DeviceQueue::beginRecording() {
  if (collecting > 0 || oneByOne || mode == ProgramMode::Launches)
    return Status::success();
  Status status;
  if (recording == Recording::AwaitsSweep)
    status = flush();
  recorded->begin();
  // Launches between two recordings become part of the sequence of the second
  // one.
  if (watches && recorded->areAnyKnown())
    prefixes->begin();
  else if (watches)
    prefixes->interrupt();
  watches = false;
  recording = Recording::Open;
  return status;
}

Status DeviceQueue::endRecording(bool isSwept) {
  if (!isRecording())
    return Status::success();
  Status status;
  if (collecting > 0) {
    recorded->end();
  } else if (isSwept && recorded->isWhole()) {
    recording = Recording::AwaitsSweep;
    return status;
  } else if (isGathering()) {
    status = flush();
    watches = collection.hasProgram;
    prefixes->end(watches);
  } else {
    recorded->end();
  }
  recording = Recording::None;
  return status;
}

Status DeviceQueue::launchRecorded(Function &function, const LaunchShape &shape,
                                   const uint64_t *slots, int count) {
  Status status;
  // A launch is not collected if it comes in place of the expected sweep, or
  // while other libraries share raw memory.
  if (recording == Recording::AwaitsSweep ||
      numShared.load(std::memory_order_relaxed) > 0) {
    status = flush();
    if (status)
      status = launchNow(function, shape, slots, count);
    return status;
  }
  if (recorded->expects({&function, shape.blocks, shape.threads, count})) {
    collected->addLaunch(function, shape, slots, count);
    isKeeping = true;
    return status;
  }
  if (isKeeping)
    status = flush(/*isWhole=*/false);
  if (!status)
    return status;
  return recorded->timed(
      [&] { return launchNow(function, shape, slots, count); });
}

Status DeviceQueue::copyKept(const DeviceRows &to, DevicePtr from,
                             int64_t fromStep) {
  bool isDense = to.rows == 1 && to.outer == 1;
  if (collecting > 0 || isGathering()) {
    if (!isDense)
      collected->addRows(Step::Kind::CopyRows, to, from, fromStep);
    else if (to.rowBytes > 0)
      collected->addCopy(to.address, from, to.rowBytes);
    isKeeping |= collecting == 0;
    return Status::success();
  }
  Status status;
  if (!isRecording())
    status = settle();
  else if (isKeeping)
    status = flush(/*isWhole=*/false);
  if (!status)
    return status;
  return isDense ? device->copy(to.address, from, to.rowBytes)
                 : device->copyRows(to, from, fromStep);
}

//===----------------------------------------------------------------------===//
// Keeping launches
//===----------------------------------------------------------------------===//

bool DeviceQueue::keepsLaunches() const { return !prefix->empty(); }
bool DeviceQueue::expectsLaunches() const {
  return watches && prefixes->areAnyKnown();
}

bool DeviceQueue::keep(Function &function, const LaunchShape &shape,
                       const uint64_t *slots, int count) {
  // Launches are not deferred while other libraries use raw addresses, since
  // these libraries would not ask for the launches to be queued.
  if (numShared.load(std::memory_order_relaxed) > 0)
    prefixes->interrupt();
  else if (prefixes->expects(&function, shape, count)) {
    prefix->append(*collected);
    *collected = Sequence();
    prefix->addLaunch(function, shape, slots, count);
    isKeeping = true;
    return true;
  }
  watches = prefixes->isOpen();
  return false;
}

Status DeviceQueue::runPrefix() {
  Sequence before = std::move(*prefix);
  *prefix = Sequence();
  return before.run(*device);
}

//===----------------------------------------------------------------------===//
// Memory and code
//===----------------------------------------------------------------------===//

template <typename Allocate>
Status DeviceQueue::allocateBlock(const Allocate &allocate, DevicePtr &memory) {
  // Host memory is allocated first: if that fails, no device memory leaks.
  Blocks made;
  Blocks::node_type block = made.extract(made.emplace(0, 0).first);
  Status status = allocate();
  if (!status)
    return status;
  block.key() = block.mapped() = memory;
  blocks.insert(std::move(block));
  return status;
}

Status DeviceQueue::allocate(int64_t bytes, DevicePtr &memory) {
  return allocateBlock(
      [&] {
        Status status = device->allocate(bytes, memory);
        if (status || released.empty() || collecting > 0 ||
            status.code() != StatusCode::Memory)
          return status;
        // Running the collected work frees memory that was released while that
        // work could use it.
        status = flush();
        return status ? device->allocate(bytes, memory) : std::move(status);
      },
      memory);
}

Status DeviceQueue::reserve(int64_t bytes, DevicePtr &memory) {
  return allocateBlock([&] { return device->reserve(bytes, memory); }, memory);
}

void DeviceQueue::forget(Module &module) {
  if (!checkHandler()) {
    auto kept = std::make_unique<Module>();
    kept->whenGone = [this](Module &module) { forget(module); };
    kept->module = std::move(module.module);
    kept->functions = std::move(module.functions);
    retired.push_back(std::move(kept));
    return;
  }
  (void)settle();
  // Programs refer to functions by addresses that later functions can get, so
  // programs with functions of a destroyed module are dropped.
  for (auto program = known.begin(); program != known.end();)
    program = program->second->uses(module) ? known.erase(program)
                                            : std::next(program);
  recorded->forget(
      [&](const DeviceFunction *function) { return module.has(function); });
}
