//===- DeviceQueue.cpp - Work for a device, collected ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Queue/DeviceQueue.h"
#include "RecordedLaunches.h"
#include "SequencePrefixes.h"
#include "tai/ABI/DeviceAbi.h"
#include "tai/Runtime/Programs/DeviceProgram.h"
#include "tai/Runtime/Threads/Section.h"
#include <algorithm>
#include <cstring>
#include <utility>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::programs;

DeviceQueue::DeviceQueue(std::unique_ptr<Device> device, Device *unwatched)
    : device(std::move(device)), unwatched(unwatched),
      collected(std::make_unique<Sequence>()),
      prefix(std::make_unique<Sequence>()),
      prefixes(std::make_unique<SequencePrefixes>()),
      recorded(std::make_unique<RecordedLaunches>()) {
  setOneByOne(false);
}

DeviceQueue::~DeviceQueue() {
  (void)flush();
  known.clear();
}

//===----------------------------------------------------------------------===//
// Code
//===----------------------------------------------------------------------===//

Status DeviceQueue::load(const DeviceImage &image,
                         std::unique_ptr<DeviceModule> &module) {
  auto made = std::make_unique<Module>();
  made->whenGone = [this](Module &module) { forget(module); };
  made->bitcode = image.bitcode;
  made->key = image.key;
  for (size_t i = 0; i < image.accesses.size(); ++i)
    if (auto accesses = FunctionAccesses::decode(image.accesses[i])) {
      made->footprints.emplace(image.functions[i],
                               std::make_shared<Footprint>(*accesses));
      if (!accesses->sites.empty())
        made->tileable.emplace(
            image.functions[i],
            std::make_shared<FunctionAccesses>(std::move(*accesses)));
    }
  Status status = device->load(image, made->module);
  if (status)
    module = std::move(made);
  return status;
}

Status DeviceQueue::makeLibrary(const std::vector<std::string> &names,
                                DeviceImage &image) const {
  ProgramPlan plan;
  for (const std::string &name : names)
    plan.parts.push_back({nullptr, name});
  plan.scope = TAI_SCOPE_NONE;
  return makeProgram(plan, image);
}

Status DeviceQueue::find(DeviceModule &module, const std::string &name,
                         DeviceFunction *&function) {
  auto &owner = static_cast<Module &>(module);
  auto made = std::make_unique<Function>();
  made->name = name;
  made->bitcode = owner.bitcode;
  made->imageKey = owner.key;
  if (auto found = owner.footprints.find(name); found != owner.footprints.end())
    made->footprint = found->second;
  if (auto found = owner.tileable.find(name); found != owner.tileable.end())
    made->accesses = found->second;
  Status status = device->find(*owner.module, name, made->function);
  if (!status)
    return status;
  function = made.get();
  owner.functions.push_back(std::move(made));
  return status;
}

unsigned DeviceQueue::mostThreads(const DeviceFunction &function) const {
  return device->mostThreads(*static_cast<const Function &>(function).function);
}

unsigned DeviceQueue::residentBlocks(const DeviceFunction &function,
                                     unsigned threads) const {
  return device->residentBlocks(
      *static_cast<const Function &>(function).function, threads);
}

//===----------------------------------------------------------------------===//
// Work
//===----------------------------------------------------------------------===//

DeviceFunctionFacts DeviceQueue::facts(const DeviceFunction &function) const {
  return device->facts(*static_cast<const Function &>(function).function);
}

Status DeviceQueue::launch(DeviceFunction &function, const LaunchShape &shape,
                           const uint64_t *slots, int count) {
  auto &wrapped = static_cast<Function &>(function);
  if (__builtin_expect(collecting == 0, true)) {
    if (__builtin_expect(runDepth.has_value(), false))
      if (Status status = checkHandler(); !status)
        return status;
    if (__builtin_expect(isRecording(), false))
      return launchRecorded(wrapped, shape, slots, count);
    if (__builtin_expect(watches, false) && keep(wrapped, shape, slots, count))
      return Status::success();
    if (__builtin_expect(isKeeping, false))
      if (Status status = flush(/*isWhole=*/false); !status)
        return status;
    return launchNow(function, shape, slots, count);
  }
  collected->addLaunch(wrapped, shape, slots, count);
  return Status::success();
}

Status DeviceQueue::launchNow(DeviceFunction &function,
                              const LaunchShape &shape, const uint64_t *slots,
                              int count) {
  return launcher->launch(*static_cast<Function &>(function).function, shape,
                          slots, count);
}

Status DeviceQueue::copy(DevicePtr to, DevicePtr from, int64_t bytes) {
  if (collecting == 0) {
    Status status = settle();
    return status ? device->copy(to, from, bytes) : std::move(status);
  }
  if (bytes > 0)
    collected->addCopy(to, from, bytes);
  return Status::success();
}

Status DeviceQueue::fill(DevicePtr to, const void *pattern, int patternBytes,
                         int64_t count) {
  return fillRows({to, 0, patternBytes * count, 1}, pattern, patternBytes);
}

Status DeviceQueue::copyRows(const DeviceRows &to, DevicePtr from,
                             int64_t fromStep) {
  if (collecting == 0) {
    Status status = settle();
    return status ? device->copyRows(to, from, fromStep) : std::move(status);
  }
  collected->addRows(Step::Kind::CopyRows, to, from, fromStep);
  return Status::success();
}

Status DeviceQueue::swapRows(const DeviceRows &one, DevicePtr other,
                             int64_t otherStep) {
  if (collecting == 0) {
    Status status = settle();
    return status ? device->swapRows(one, other, otherStep) : std::move(status);
  }
  collected->addRows(Step::Kind::SwapRows, one, other, otherStep);
  return Status::success();
}

Status DeviceQueue::fillRows(const DeviceRows &to, const void *pattern,
                             int patternBytes) {
  if (to.rowBytes == 0 || to.rows == 0 || to.outer == 0)
    return Status::success();
  collected->addFill(to, pattern, patternBytes);
  // The fill is kept until other work needs its result: it can be merged with
  // neighbouring fills, or become part of the next sequence.
  isKeeping |= collecting == 0;
  return oneByOne ? settle() : Status::success();
}

/// Bytes between two safepoints of a copy between host and device: a copy of a
/// few milliseconds, compared with which a wait for the device is short.
static constexpr int64_t bytesPerCopy = 16 << 20;

Status DeviceQueue::copyIn(DevicePtr to, const void *from, int64_t bytes) {
  Status status = flush();
  return status
             ? safepoint::runInPieces(
                   bytes, bytesPerCopy, /*canStop=*/true,
                   [&](int64_t at, int64_t count) {
                     return device->copyIn(to + static_cast<DevicePtr>(at),
                                           static_cast<const char *>(from) + at,
                                           count);
                   })
             : std::move(status);
}

Status DeviceQueue::copyOut(void *to, DevicePtr from, int64_t bytes) {
  Status status = flush();
  return status
             ? safepoint::runInPieces(bytes, bytesPerCopy, /*canStop=*/true,
                                      [&](int64_t at, int64_t count) {
                                        return device->copyOut(
                                            static_cast<char *>(to) + at,
                                            from + static_cast<DevicePtr>(at),
                                            count);
                                      })
             : std::move(status);
}

Status DeviceQueue::record(std::unique_ptr<DeviceEvent> &event) {
  Status status = flush();
  return status ? device->record(event) : std::move(status);
}

Status DeviceQueue::waitForStream(uint64_t stream) {
  Status status = flush();
  return status ? device->waitForStream(stream) : std::move(status);
}

Status DeviceQueue::letStreamWait(uint64_t stream) {
  Status status = flush();
  return status ? device->letStreamWait(stream) : std::move(status);
}

Status DeviceQueue::synchronize() {
  Status status = flush();
  return status ? device->synchronize() : std::move(status);
}

void DeviceQueue::free(DevicePtr memory) {
  // Collected work may use the memory, so it is queued first. A recording goes
  // on: its memory is released after the work, so the thread need not wait.
  bool isOutOfMemory = false;
  try {
    if (!isRecording())
      (void)settle();
  } catch (const std::bad_alloc &) {
    isOutOfMemory = true;
  }
  Blocks::node_type block = blocks.extract(memory);
  if (block.empty() || (collected->empty() && prefix->empty() && !runDepth)) {
    device->free(memory);
  } else {
    block.key() = numReleased++;
    released.insert(std::move(block));
  }
  if (isOutOfMemory)
    throw std::bad_alloc();
}

//===----------------------------------------------------------------------===//
// Sequences
//===----------------------------------------------------------------------===//

DeviceProgram *DeviceQueue::findProgram(Sequence &&sequence, bool &same) {
  auto range = known.equal_range(sequence.hash);
  for (auto it = range.first; it != range.second; ++it)
    if (it->second->sequence.hasStructureOf(sequence)) {
      DeviceProgram &program = *it->second;
      same = program.sequence.slots == sequence.slots;
      if (!same)
        program.sequence = std::move(sequence);
      return &program;
    }
  // The number of programs is limited, since sequences that are never repeated
  // get programs, too.
  constexpr size_t mostPrograms = 64;
  if (known.size() >= mostPrograms)
    known.clear();
  // If memory runs out in this statement, no program is made and `sequence`
  // keeps its steps.
  auto added = known.emplace(sequence.hash, nullptr);
  try {
    added->second =
        std::make_unique<DeviceProgram>(*device, std::move(sequence));
  } catch (const std::bad_alloc &) {
    known.erase(added);
    throw;
  }
  same = false;
  return added->second.get();
}

Status DeviceQueue::checkHandler() const {
  return runDepth && safepoint::handlerDepth() > *runDepth
             ? failAsInterruptedWork()
             : Status::success();
}

Status DeviceQueue::flush(bool isWhole) {
  Status status = checkHandler();
  if (!status || (collected->empty() && prefix->empty()))
    return status;
  {
    // Restores `depth` at the end of the scope, even if memory runs out.
    struct Running {
      std::optional<unsigned> &depth;
      std::optional<unsigned> outer =
          std::exchange(depth, safepoint::handlerDepth());
      ~Running() { depth = outer; }
    } running{runDepth};
    status = runCollected(isWhole);
  }
  if (runDepth)
    return status;
  // Memory that signal handlers have released meanwhile is freed.
  if (collected->empty() && prefix->empty()) {
    Blocks gone;
    gone.swap(released);
    for (const auto &[number, memory] : gone)
      device->free(memory);
  }
  std::exchange(retired, {}).clear();
  return status;
}

Status DeviceQueue::runCollected(bool isWhole) {
  isKeeping = false;
  // The collected sequence and its prefix are emptied first, since running
  // their steps may queue more work.
  Sequence sequence = std::move(*collected), before = std::move(*prefix);
  *collected = Sequence();
  *prefix = Sequence();
  struct Unused {
    Device &device;
    Blocks memory;
    ~Unused() {
      for (const auto &[number, address] : memory)
        device.free(address);
    }
  } unused{*device, {}};
  unused.memory.swap(released);
  Status status;
  // The fewest steps for which a graph is worth its cost.
  constexpr size_t fewest = 4;
  RecordedLaunches::Outcome outcome;
  if (!isWhole || sequence.steps.size() < fewest ||
      mode == ProgramMode::Launches || oneByOne) {
    bool isOutOfMemory = false;
    for (const Sequence *part : {&before, &sequence})
      try {
        if (status)
          status = part->run(*device);
      } catch (const std::bad_alloc &) {
        isOutOfMemory = true;
      }
    if (isOutOfMemory)
      throw std::bad_alloc();
  } else {
    bool same = false;
    DeviceProgram *program = nullptr;
    try {
      program = findProgram(std::move(sequence), same);
    } catch (const std::bad_alloc &) {
      // Without memory for a program, `sequence` is unchanged and can run step
      // by step.
    }
    int64_t start = recorded->hasRun() ? RecordedLaunches::now() : 0;
    if (program) {
      status = program->run(before, same, mode,
                            {makeProgram, startProgram, choices});
    } else {
      status = before.run(*device);
      if (status)
        status = sequence.run(*device);
    }
    collection.hasProgram = program && program->isPrepared();
    if (program && recorded->hasRun()) {
      outcome.isPrepared = collection.hasProgram;
      outcome.steps = program->sequence.steps.size();
      outcome.hostNs = RecordedLaunches::now() - start;
      program->tellTimes(outcome.chosenMs, outcome.graphMs);
    }
  }
  if (recorded->hasRun())
    recorded->judge(outcome);
  return status;
}

std::string DeviceQueue::explain() const {
  std::string text;
  for (const auto &[hash, program] : known)
    text += program->explain() + "\n";
  return text + prefixes->explain() + recorded->explain();
}
