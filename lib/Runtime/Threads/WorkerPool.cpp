//===- WorkerPool.cpp - Fork and join in under a microsecond --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// See docs/decisions/parallel-loops.md for measurements of the pool.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Threads/WorkerPool.h"
#include "tai/Runtime/Threads/PollPause.h"
#include "tai/Runtime/Threads/Safepoint.h"
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <new>
#include <sched.h>
#include <signal.h>
#include <sys/mman.h>
#include <unistd.h>

using namespace mlir::tai::runtime;

namespace {
using Clock = std::chrono::steady_clock;

/// An idle worker spins this long (first pausing, then yielding its core to
/// other threads) before it sleeps. Waking a worker costs the caller some 15 us
/// on a virtual machine, a hundred times a fork to a worker that spins.
constexpr auto pauseFor = std::chrono::microseconds(50);
constexpr auto yieldUntil = std::chrono::microseconds(500);

constexpr uint64_t packRange(uint64_t next, uint64_t end) {
  return end << 32 | next;
}
inline bool isEmpty(uint64_t range) {
  return (range & 0xffffffffu) >= (range >> 32);
}

/// Spins until `done()` is true; false if the time `yieldUntil` has passed
/// before.
template <typename Done> bool spinUntil(const Done &done) {
  Clock::time_point start;
  for (unsigned round = 0;; ++round) {
    // Reading the clock costs as much as a pause, so the clock is read only now
    // and then.
    for (int i = 0; i < 32; ++i) {
      if (done())
        return true;
      pauseCpu();
    }
    auto now = Clock::now();
    if (round == 0)
      start = now;
    auto waited = now - start;
    if (waited > pauseFor)
      sched_yield();
    if (waited > yieldUntil)
      return false;
  }
}
} // namespace

//===----------------------------------------------------------------------===//
// ForkGuard
//===----------------------------------------------------------------------===//

ForkGuard::ForkGuard() {
  size_t size = static_cast<size_t>(sysconf(_SC_PAGESIZE));
  void *memory = mmap(nullptr, size, PROT_READ | PROT_WRITE,
                      MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (memory != MAP_FAILED) {
    if (madvise(memory, size, MADV_WIPEONFORK) == 0)
      page = static_cast<volatile uint32_t *>(memory);
    else
      munmap(memory, size);
  }
  rearm();
}

ForkGuard::~ForkGuard() {
  if (page)
    munmap(const_cast<uint32_t *>(page),
           static_cast<size_t>(sysconf(_SC_PAGESIZE)));
}

bool ForkGuard::sameProcess() const {
  // Without the page, as on an old kernel, each fork-join calls getpid() to
  // find out whether the process has forked.
  return page ? *page == 1 : owner == getpid();
}

void ForkGuard::rearm() {
  if (page)
    *page = 1;
  owner = getpid();
}

//===----------------------------------------------------------------------===//
// WorkerPool
//===----------------------------------------------------------------------===//

namespace {
struct WorkerStart {
  WorkerPool *pool;
  int self;
};
} // namespace

WorkerPool::WorkerPool(int threads)
    : numThreads(std::max(1, threads)),
      shares(new Share[static_cast<size_t>(std::max(1, threads))]) {
  workers.reserve(static_cast<size_t>(numThreads - 1));
  // Worker threads block all signals, which the threads of the program handle.
  sigset_t all, old;
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &old);
  for (int i = 1; i < numThreads; ++i) {
    auto *start = new (std::nothrow) WorkerStart{this, i};
    if (!start)
      break;
    pthread_t thread;
    if (pthread_create(&thread, nullptr, &WorkerPool::workerMain, start) != 0) {
      // If the system creates no more threads, the existing ones do the work.
      delete start;
      break;
    }
    workers.push_back(thread);
  }
  pthread_sigmask(SIG_SETMASK, &old, nullptr);
}

WorkerPool::~WorkerPool() {
  closing.store(true);
  epoch.fetch_add(1);
  {
    std::lock_guard<std::mutex> lock(sleepMutex);
    sleepCondition.notify_all();
  }
  for (pthread_t worker : workers)
    pthread_join(worker, nullptr);
}

void *WorkerPool::workerMain(void *argument) {
  WorkerStart start = *static_cast<WorkerStart *>(argument);
  delete static_cast<WorkerStart *>(argument);
  pthread_setname_np(pthread_self(), "tai-worker");
  safepoint::enterWorker();
  start.pool->workerLoop(start.self);
  return nullptr;
}

void WorkerPool::workerLoop(int self) {
  uint32_t seen = 0;
  while (awaitJob(seen))
    work(self);
}

bool WorkerPool::awaitJob(uint32_t &seen) {
  auto arrived = [&] { return epoch.load(std::memory_order_acquire) != seen; };
  if (!spinUntil(arrived)) {
    std::unique_lock<std::mutex> lock(sleepMutex);
    // The caller increments `epoch` and then reads `sleepers`: either this
    // worker sees the new epoch, or the caller sees that the worker sleeps.
    sleepers.fetch_add(1);
    bool slept = false;
    while (epoch.load() == seen) {
      sleepCondition.wait(lock);
      slept = true;
    }
    sleepers.fetch_sub(1);
    // Each woken worker thread wakes two more, so that the caller wakes only
    // one.
    if (slept) {
      sleepCondition.notify_one();
      sleepCondition.notify_one();
    }
  }
  seen = epoch.load(std::memory_order_acquire);
  return !closing.load(std::memory_order_relaxed);
}

void WorkerPool::work(int self) {
  for (int i = 0; i < numThreads; ++i) {
    int victim = self + i;
    Share &share = shares[victim < numThreads ? victim : victim - numThreads];
    int64_t done = 0;
    while (!isEmpty(share.range.load(std::memory_order_relaxed))) {
      uint64_t range = share.range.fetch_add(1, std::memory_order_acq_rel);
      if (isEmpty(range))
        break;
      jobTask(jobContext, static_cast<int64_t>(range & 0xffffffffu));
      ++done;
    }
    if (done)
      finished.fetch_add(done, std::memory_order_release);
  }
}

bool WorkerPool::tryRun(Task task, void *context, int64_t parts,
                        void (*look)(void *context)) {
  bool free = false;
  if (!taken.compare_exchange_strong(free, true, std::memory_order_acquire))
    return false;
  jobTask = task;
  jobContext = context;
  finished.store(0, std::memory_order_relaxed);
  for (int i = 0; i < numThreads; ++i) {
    uint64_t next = static_cast<uint64_t>(parts * i / numThreads);
    uint64_t end = static_cast<uint64_t>(parts * (i + 1) / numThreads);
    shares[i].range.store(packRange(next, end), std::memory_order_release);
  }
  epoch.fetch_add(1);
  if (sleepers.load() > 0) {
    std::lock_guard<std::mutex> lock(sleepMutex);
    sleepCondition.notify_one();
  }
  work(0);
  auto isDone = [&] {
    return finished.load(std::memory_order_acquire) == parts;
  };
  uint64_t seen = safepoint::now();
  while (!spinUntil(isDone))
    if (look && safepoint::now() != seen) {
      seen = safepoint::now();
      look(context);
    }
  taken.store(false, std::memory_order_release);
  return true;
}

//===----------------------------------------------------------------------===//
// Number of threads
//===----------------------------------------------------------------------===//

int mlir::tai::runtime::availableThreads() {
  int count = 0;
  cpu_set_t mask;
  if (sched_getaffinity(0, sizeof(mask), &mask) == 0)
    count = CPU_COUNT(&mask);
  if (count <= 0)
    count = static_cast<int>(sysconf(_SC_NPROCESSORS_ONLN));
  // A container with a quota may use fewer cores than it sees; threads that
  // spin on the remaining cores would use the quota up.
  if (FILE *file = std::fopen("/sys/fs/cgroup/cpu.max", "re")) {
    long long quota = 0, period = 0;
    if (std::fscanf(file, "%lld %lld", &quota, &period) == 2 && quota > 0 &&
        period > 0)
      count =
          std::min<int>(count, static_cast<int>((quota + period - 1) / period));
    std::fclose(file);
  }
  return std::max(1, count);
}
