//===- Workers.h - Loops on several threads ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The worker threads of one runtime, started by the first loop that needs them,
// and the partitioning of loops.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_THREADS_WORKERS_H
#define TAI_RUNTIME_THREADS_WORKERS_H

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>

namespace mlir::tai::runtime {

class ForkGuard;
class WorkerPool;

class Workers {
public:
  /// `threads`: the number of threads; 0 means as many as the process may use.
  explicit Workers(int threads = 0);
  ~Workers();
  Workers(const Workers &) = delete;
  Workers &operator=(const Workers &) = delete;

  int threads() const { return numThreads; }
  void setThreads(int threads);

  /// The number of partitions for a loop of `n` iterations of `cost`
  /// nanoseconds each, estimated by the compiler or measured.
  int64_t partition(int64_t n, double cost, bool reduces);
  /// The nanoseconds of work below which a fork is not worth it even if workers
  /// are spinning.
  static constexpr int64_t leastNs = 4000;
  /// The number of parts for work on `bytes` bytes with `bytesPerPart` or more
  /// in each part; at most two parts for each thread.
  int64_t partsOf(int64_t bytes, int64_t bytesPerPart) const {
    return std::clamp<int64_t>(bytes / bytesPerPart, 1,
                               2 * int64_t(numThreads));
  }

  /// Calls task(context, p) for each p in [0, parts), on the worker threads and
  /// the calling thread. While the calling thread waits for the workers, it
  /// calls `look` repeatedly, unless that is null.
  void parallel(int64_t parts, void (*task)(void *context, int64_t part),
                void *context, void (*look)(void *context) = nullptr);

  /// numForks: the number of loops that used worker threads. numInline: the
  /// number of loops that ran on the calling thread alone, mostly because they
  /// were too small for a fork.
  int64_t numForks() const { return forks.load(std::memory_order_relaxed); }
  int64_t numInline() const {
    return inlineLoops.load(std::memory_order_relaxed);
  }

private:
  WorkerPool &get();
  /// Must be called in a forked child process, where the worker threads do not
  /// exist.
  void leaveParent();

  int numThreads;
  std::unique_ptr<ForkGuard> forkGuard;
  std::unique_ptr<WorkerPool> pool;
  std::mutex mutex;
  std::atomic<WorkerPool *> current{nullptr};
  std::atomic<int64_t> inlineCredit{0};
  std::atomic<int64_t> forks{0}, inlineLoops{0};
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_THREADS_WORKERS_H
