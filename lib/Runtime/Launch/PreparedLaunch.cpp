//===- PreparedLaunch.cpp - The fast path of a launch ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Most launches are of a kernel without gradients that was launched before,
// with the same storage and no tape, profiler or forward mode. Their common
// data is kept with the kernel, and one number tells whether it is still valid.
// On a device the driver evicts most of the caches, so the number of cache
// lines that a launch reads matters.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Launch/Launcher.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include <algorithm>
#include <tuple>

using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Launch objects, which later launches reuse
//===----------------------------------------------------------------------===//

Launch *Launcher::acquire(bool isUnrecorded) {
  Launch *launch = take();
  if (__builtin_expect(!isUnrecorded, false))
    launch->isUnrecorded.store(false, std::memory_order_relaxed);
  return launch;
}

inline Launch *Launcher::take() {
  // `self` may be the number of an earlier thread that has ended; this thread
  // then takes over the launch of that thread.
  const void *self = __builtin_thread_pointer();
  const void *thread = hot.thread.load(std::memory_order_acquire);
  if (__builtin_expect(thread == self && !hot.isTaken, true)) {
    hot.isTaken = true;
    return hot.launch.load(std::memory_order_relaxed);
  }
  // This lambda is not inlined, because in line it would make each prepared
  // launch save registers.
  auto takeAnother = [&]() __attribute__((noinline)) {
    runningLaunches.noteFork();
    if (Launch *launch =
            spareLaunch.exchange(nullptr, std::memory_order_acquire)) {
      launch->thread.store(self, std::memory_order_relaxed);
      return launch;
    }
    std::lock_guard<std::mutex> lock(mutex);
    if (!freeLaunches.empty()) {
      Launch *launch = freeLaunches.back();
      freeLaunches.pop_back();
      launch->thread.store(self, std::memory_order_relaxed);
      return launch;
    }
    // Giving a launch object back must not allocate, so its place in the list
    // is reserved now.
    freeLaunches.reserve(launches.size() + 1);
    launches.push_back(std::make_unique<Launch>(owner));
    Launch *made = launches.back().get();
    made->thread.store(self, std::memory_order_relaxed);
    runningLaunches.add(*made);
    if (!hot.thread.load(std::memory_order_relaxed)) {
      hot.launch.store(made, std::memory_order_relaxed);
      hot.isTaken = true;
      hot.thread.store(self, std::memory_order_release);
    }
    return made;
  };
  return takeAnother();
}

void Launcher::release(Launch *launch) {
  if (__builtin_expect(!launch->loops.empty(), false))
    launch->loops.clear();
  if (__builtin_expect(!launch->isUnrecorded.load(std::memory_order_relaxed),
                       false))
    launch->isUnrecorded.store(true, std::memory_order_relaxed);
  if (__builtin_expect(launch == hot.launch.load(std::memory_order_relaxed),
                       true)) {
    hot.isTaken = false;
    return;
  }
  Launch *none = nullptr;
  if (spareLaunch.compare_exchange_strong(
          none, launch, std::memory_order_release, std::memory_order_relaxed))
    return;
  std::lock_guard<std::mutex> lock(mutex);
  freeLaunches.push_back(launch);
}

void Launcher::dropLaunches() {
  hot.launch = nullptr;
  hot.thread.store(nullptr, std::memory_order_relaxed);
  runningLaunches.clear();
  launches.clear();
  freeLaunches.clear();
  spareLaunch.store(nullptr, std::memory_order_relaxed);
}

//===----------------------------------------------------------------------===//
// Prepared launches
//===----------------------------------------------------------------------===//

/// References to those members of a PreparedLaunch that prepare() fills in: all
/// but `state` and `lastLaunch`.
static auto fieldsOf(PreparedLaunch &prepared) {
  PreparedLaunch &p = prepared;
  return std::tie(p.function, p.trees, p.slots, p.hasResults, p.code, p.mirrors,
                  p.mirrorsEnd, p.changed, p.changedEnd, p.adjoints,
                  p.adjointsEnd);
}

void Launcher::prepare(Kernel &kernel) {
  uint64_t epoch = hot.state.load(std::memory_order_relaxed);
  PreparedLaunch &prepared = kernel.prepared;
  if (epoch == LaunchState::never ||
      prepared.state.load(std::memory_order_relaxed) == epoch ||
      kernel.boundEpoch.load(std::memory_order_acquire) != epoch ||
      !kernel.resolved() || !kernel.bound.sparseNodes.empty() ||
      !kernel.bound.loopLevels.empty())
    return;
  Kernel::Lock lock(kernel.section);
  uint64_t before = prepared.state.load(std::memory_order_relaxed);
  // A kernel that accesses adjoints is not prepared: each of its launches first
  // stores the zeros that its fields still lack (see settleZeros).
  if (before == epoch || kernel.bound.usesAdjoints)
    return;
  PreparedLaunch made;
  if (parts.devices.isThere()) {
    const DeviceCode *code = kernel.deviceCode.get();
    if (!kernel.info.image || !code || code->epoch != epoch ||
        code->image != kernel.info.image)
      return;
    made.code = code;
    made.mirrors = code->mirrors.data();
    made.mirrorsEnd = made.mirrors + code->mirrors.size();
    made.changed = code->changed.data();
    made.changedEnd = made.changed + code->changed.size();
    made.trees = const_cast<void **>(code->bases.data());
  } else {
    made.trees = kernel.bound.bases.data();
  }
  made.function = kernel.function.load(std::memory_order_relaxed);
  made.slots = kernel.argSlots();
  made.hasResults = kernel.resultSlots() > 0;
  made.adjoints = kernel.bound.changedAdjoints.data();
  made.adjointsEnd = made.adjoints + kernel.bound.changedAdjoints.size();
  if (fieldsOf(prepared) != fieldsOf(made)) {
    // A launch of another thread may be using the present tables. No launch
    // begins to use them while `prepared.state` differs from the state of the
    // runtime.
    bool isUsed = false;
    if (before != 0) {
      runningLaunches.publishState();
      runningLaunches.visit([&](const Launch &launch, const Kernel &other) {
        isUsed |= &other == &kernel && !launch.isOfThisThread();
      });
    }
    if (isUsed)
      return;
    fieldsOf(prepared) = fieldsOf(made);
  }
  prepared.state.store(epoch, std::memory_order_release);
}

Status Launcher::launchPrepared(Kernel &kernel, const uint64_t *args,
                                uint64_t *results) {
  PreparedLaunch &prepared = kernel.prepared;
  Launch &launch = *take();
  uint64_t number = hot.launches.fetch_add(1, std::memory_order_relaxed);
  prepared.lastLaunch.store(number, std::memory_order_relaxed);
  DeviceLaunch *onDevice = nullptr;
  launch.begin(kernel);
  bool isReady = prepared.state.load(std::memory_order_relaxed) ==
                 hot.state.load(std::memory_order_relaxed);
  if (isReady && prepared.code) {
    onDevice = launch.onDevice.get();
    isReady = onDevice && !onDevice->context->hasNoted();
    for (auto *mirror = prepared.mirrors; mirror != prepared.mirrorsEnd;
         ++mirror)
      isReady &= (*mirror)->onDevice();
  }
  if (__builtin_expect(!isReady, false)) {
    launch.end();
    Status status;
    try {
      status = run(launch, kernel, args, results, number);
    } catch (...) {
      launch.recover();
      release(&launch);
      throw;
    }
    release(&launch);
    return status;
  }
  if (onDevice) {
    onDevice->code = prepared.code;
    onDevice->usesState = onDevice->waited = false;
  }
  launch.trees = prepared.trees;
  launch.args = args;
  launch.results = results;
  launch.seed = hot.seed;
  launch.launch = number;
  launch.loopTimes = &kernel.loopTimes;
  int32_t code = prepared.function(&launch);
  for (auto *mirror = prepared.changed; mirror != prepared.changedEnd; ++mirror)
    (*mirror)->deviceWrites();
  for (auto *field = prepared.adjoints; field != prepared.adjointsEnd; ++field)
    (*field)->markDirty();
  if (onDevice) {
    if (__builtin_expect(onDevice->isFinished(), true))
      onDevice->code = nullptr;
    else
      deviceLaunches.leave(launch);
  }
  if (launch.arena.used())
    launch.arena.reset();
  Status status;
  if (__builtin_expect(code != 0 || launch.hasFailed(), false)) {
    launch.freeSinks();
    try {
      status = failureOf(launch, kernel);
    } catch (...) {
      launch.recover();
      release(&launch);
      throw;
    }
  }
  launch.end();
  release(&launch);
  return status;
}
