//===- RunningLaunches.cpp - Running launches of all threads --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/RunningLaunches.h"
#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Threads/WorkerPool.h"
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

void RunningLaunches::clear() {
  std::lock_guard<std::mutex> lock(mutex);
  launches.clear();
  count.store(0, std::memory_order_seq_cst);
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

bool RunningLaunches::areAny() const {
  size_t made = count.load(std::memory_order_seq_cst);
  return made > 1 || (made == 1 && first.load(std::memory_order_relaxed) !=
                                       __builtin_thread_pointer());
}

/// Executes a memory fence on every running thread of the process.
static void fenceAllThreads() {
  static const bool isReady =
      syscall(SYS_membarrier, MEMBARRIER_CMD_REGISTER_PRIVATE_EXPEDITED, 0,
              0) == 0;
  std::atomic_thread_fence(std::memory_order_seq_cst);
  // A system without membarrier has no fence for all threads. Hosts that hold a
  // lock around their calls, such as Python, do not need it.
  if (isReady)
    (void)syscall(SYS_membarrier, MEMBARRIER_CMD_PRIVATE_EXPEDITED, 0, 0);
}

void RunningLaunches::publishState() const {
  if (areAny())
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

void RunningLaunches::visitChanges(
    const std::function<void(const std::string &, const Field &, HoldKind)>
        &visitChange) {
  visit([&](const Launch &launch, const Kernel &kernel) {
    if (launch.isOfThisThread() ||
        !launch.isUnrecorded.load(std::memory_order_relaxed))
      return;
    for (const Access &access : kernel.summary())
      if (access.kind != AccessKind::Read)
        visitChange(kernel.name(), *access.field, holdKindOf(access.kind));
  });
}

Status RunningLaunches::checkUnused(const Tree &tree, const TreeStore &store) {
  publishState();
  Status status;
  visit([&](const Launch &launch, const Kernel &kernel) {
    if (!kernel.uses(tree))
      return;
    FieldPtr field = store.firstOf(tree);
    std::string what = field ? "the tree of field '" + field->name() + "'"
                             : "tree '" + tree.name() + "'";
    std::string who =
        launch.isOfThisThread() ? "this thread" : "another thread";
    status = Status::failure(
        StatusCode::Usage,
        what + " cannot be destroyed while " + who + " runs kernel '" +
            kernel.name() +
            "', which uses it: wait until the kernel has returned");
  });
  return status;
}
