//===- Workers.cpp - Loops on several threads -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Threads/Workers.h"
#include "tai/Runtime/Threads/FixedParts.h"
#include "tai/Runtime/Threads/WorkerPool.h"
#include <new>

using namespace mlir::tai::runtime;

static int threadsFor(int wanted) {
  return wanted > 0 ? std::min(wanted, 1024) : availableThreads();
}

Workers::Workers(int threads)
    : numThreads(threadsFor(threads)), forkGuard(new ForkGuard) {}

Workers::~Workers() {
  if (!forkGuard->sameProcess())
    (void)pool.release();
}

void Workers::leaveParent() {
  if (forkGuard->sameProcess())
    return;
  // The child leaks the pool of the parent, which may have been in the middle
  // of a loop.
  (void)pool.release();
  forkGuard->rearm();
}

void Workers::setThreads(int threads) {
  int wanted = threadsFor(threads);
  if (wanted == numThreads)
    return;
  std::lock_guard<std::mutex> lock(mutex);
  leaveParent();
  current.store(nullptr, std::memory_order_release);
  pool.reset();
  numThreads = wanted;
}

WorkerPool &Workers::get() {
  WorkerPool *known = current.load(std::memory_order_acquire);
  if (__builtin_expect(known && forkGuard->sameProcess(), true))
    return *known;
  std::lock_guard<std::mutex> lock(mutex);
  leaveParent();
  if (!pool)
    pool = std::make_unique<WorkerPool>(numThreads);
  current.store(pool.get(), std::memory_order_release);
  return *pool;
}

namespace {
/// A task for worker threads whose exceptions do not leave the thread on which
/// they are thrown.
struct SafeTask {
  void (*task)(void *context, int64_t part);
  void *context;
  void (*look)(void *context);
  std::atomic<bool> isOutOfMemory{false};

  static void run(void *self, int64_t part) noexcept {
    auto &safe = *static_cast<SafeTask *>(self);
    try {
      safe.task(safe.context, part);
    } catch (...) {
      safe.isOutOfMemory.store(true, std::memory_order_relaxed);
    }
  }
  static void lookOnce(void *self) noexcept {
    auto &safe = *static_cast<SafeTask *>(self);
    try {
      safe.look(safe.context);
    } catch (...) {
      safe.isOutOfMemory.store(true, std::memory_order_relaxed);
    }
  }
};
} // namespace

void Workers::parallel(int64_t parts, void (*task)(void *context, int64_t part),
                       void *context, void (*look)(void *context)) {
  if (parts > 1 && numThreads > 1) {
    SafeTask safe{task, context, look};
    if (get().tryRun(&SafeTask::run, &safe, parts,
                     look ? &SafeTask::lookOnce : nullptr)) {
      forks.fetch_add(1, std::memory_order_relaxed);
      if (safe.isOutOfMemory.load(std::memory_order_relaxed))
        throw std::bad_alloc();
      return;
    }
  }
  inlineLoops.fetch_add(1, std::memory_order_relaxed);
  for (int64_t part = 0; part < parts; ++part)
    task(context, part);
}

int64_t Workers::partition(int64_t n, double cost, bool reduces) {
  // A loop below `wakeNs` does not repay a fork if workers must be woken first.
  // Loops between `leastNs` and `wakeNs` repay it together: after `wakeCredit`
  // nanoseconds of such loops, one of them forks.
  constexpr int64_t wakeNs = 50000, wakeCredit = 100000;
  if (n <= 1)
    return 1;
  double exact = static_cast<double>(n) * std::max(cost, 1e-3);
  int64_t total = exact < 9e18 ? static_cast<int64_t>(exact) : INT64_MAX;
  if (numThreads == 1)
    return 1;
  if (total < leastNs)
    return 1;
  if (total < wakeNs) {
    WorkerPool *known = current.load(std::memory_order_acquire);
    if (!known || !known->awake()) {
      if (inlineCredit.fetch_add(total, std::memory_order_relaxed) < wakeCredit)
        return 1;
      inlineCredit.store(0, std::memory_order_relaxed);
    }
  }
  constexpr int64_t leastPartNs = 2000;
  int64_t parts = std::min<int64_t>(numThreads, total / leastPartNs);
  if (!reduces) {
    // A loop is divided into smaller parts than needed, so that threads slowed
    // by other processes get fewer of them, and a long loop can be interrupted.
    constexpr int64_t goodPartNs = 25000, longestPartNs = 10000000;
    parts =
        std::max({parts, std::min<int64_t>(4 * numThreads, total / goodPartNs),
                  std::min<int64_t>(total / longestPartNs, 1 << 16)});
  }
  return std::clamp<int64_t>(parts, 1, n);
}
