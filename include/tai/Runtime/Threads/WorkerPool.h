//===- WorkerPool.h - Fork and join in under a microsecond ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Launches of a simulation follow each other within a few microseconds, so a
// fork must cost far less than that: workers spin for a moment before they
// sleep. Each thread owns a contiguous share of the parts (the same one in each
// launch, so that its cache holds the data) and steals from others when its own
// is done; the caller can run all parts itself, so a worker that the system
// does not schedule delays only the part that it is running.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_THREADS_WORKERPOOL_H
#define TAI_RUNTIME_THREADS_WORKERPOOL_H

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <pthread.h>
#include <vector>

namespace mlir::tai::runtime {

/// Detects a forked child without an atfork handler: the operating system
/// zeroes a page in the child (MADV_WIPEONFORK).
class ForkGuard {
public:
  ForkGuard();
  ~ForkGuard();
  /// True in the process that created or last rearmed the guard.
  bool sameProcess() const;
  void rearm();

private:
  volatile uint32_t *page = nullptr;
  pid_t owner = 0;
};

class WorkerPool {
public:
  /// `threads` includes the caller.
  explicit WorkerPool(int threads);
  ~WorkerPool();
  WorkerPool(const WorkerPool &) = delete;
  WorkerPool &operator=(const WorkerPool &) = delete;

  using Task = void (*)(void *context, int64_t part);

  /// Calls task(context, p) once for each p in [0, parts) and returns when all
  /// calls have returned. Returns false, with nothing done, if the workers are
  /// busy with another call (a nested loop, or another thread). While the
  /// caller waits for workers, it calls `look`, unless null, at each tick of
  /// the safepoint clock.
  bool tryRun(Task task, void *context, int64_t parts,
              void (*look)(void *context) = nullptr);

  int threads() const { return numThreads; }
  /// True while some worker spins, so that a fork costs no wake-up.
  bool awake() const {
    return sleepers.load(std::memory_order_relaxed) <
           static_cast<int>(workers.size());
  }

private:
  /// The remaining parts [next, end), packed so that one atomic addition claims
  /// a part. A late worker that adds to a share which has been refilled in the
  /// meantime works on the new job.
  struct alignas(64) Share {
    std::atomic<uint64_t> range{0};
  };

  static void *workerMain(void *argument);
  void workerLoop(int self);
  void work(int self);
  /// Waits, as a worker, for a job newer than `seen`; false if the pool is
  /// closing.
  bool awaitJob(uint32_t &seen);

  int numThreads;
  std::vector<pthread_t> workers;
  std::unique_ptr<Share[]> shares;

  alignas(64) std::atomic<bool> taken{false};
  Task jobTask = nullptr;
  void *jobContext = nullptr;

  alignas(64) std::atomic<uint32_t> epoch{0};
  std::atomic<int> sleepers{0};
  alignas(64) std::atomic<int64_t> finished{0};

  std::atomic<bool> closing{false};
  std::mutex sleepMutex;
  std::condition_variable sleepCondition;
};

/// The number of threads that this process may run at once, by its affinity
/// mask and the quota of its control group.
int availableThreads();

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_THREADS_WORKERPOOL_H
