//===- RunningLaunches.cpp - Which kernels run in which thread ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/RunningLaunches.h"
#include "Launch.h"
#include "WorkerPool.h"
#include <linux/membarrier.h>
#include <sys/syscall.h>
#include <unistd.h>

using namespace mlir::tai::runtime;

RunningLaunches::RunningLaunches() : guard(new ForkGuard) {}

RunningLaunches::~RunningLaunches() = default;

void RunningLaunches::add(Launch &launch) {
  {
    std::lock_guard<std::mutex> lock(mutex);
    if (launches.empty())
      first.store(__builtin_thread_pointer(), std::memory_order_relaxed);
    launches.push_back(&launch);
    count.store(launches.size(), std::memory_order_seq_cst);
  }
  std::atomic_thread_fence(std::memory_order_seq_cst);
}

bool RunningLaunches::isSameProcess() const { return guard->sameProcess(); }

void RunningLaunches::forgetParents() {
  std::lock_guard<std::mutex> lock(mutex);
  if (guard->sameProcess())
    return;
  for (Launch *launch : launches)
    if (!launch->isOfThisThread())
      launch->end();
  guard->rearm();
}

bool RunningLaunches::areOthers() const {
  size_t made = count.load(std::memory_order_seq_cst);
  return made > 1 || (made == 1 && first.load(std::memory_order_relaxed) !=
                                       __builtin_thread_pointer());
}

/// A fence in every thread of the process that runs.
static void fenceAllThreads() {
  static const bool isReady =
      syscall(SYS_membarrier, MEMBARRIER_CMD_REGISTER_PRIVATE_EXPEDITED, 0,
              0) == 0;
  std::atomic_thread_fence(std::memory_order_seq_cst);
  // Where the system has none, a host with a lock around its calls, such as
  // Python, does without.
  if (isReady)
    (void)syscall(SYS_membarrier, MEMBARRIER_CMD_PRIVATE_EXPEDITED, 0, 0);
}

void RunningLaunches::letLaunchesSee() const {
  if (areOthers())
    fenceAllThreads();
}

void RunningLaunches::visit(
    const std::function<void(const Launch &, const Kernel &)> &visit) {
  noteFork();
  std::lock_guard<std::mutex> lock(mutex);
  for (Launch *launch : launches)
    if (const Kernel *kernel = launch->running.load(std::memory_order_acquire))
      visit(*launch, *kernel);
}
