//===- Workers.h - Loops on several threads ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The worker threads of one runtime, which begin when the first loop wants
// them, and into how many parts a loop is cut.
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
  /// 0 for as many threads as the process may use.
  explicit Workers(int threads = 0, bool deterministic = false);
  ~Workers();
  Workers(const Workers &) = delete;
  Workers &operator=(const Workers &) = delete;

  int threads() const { return numThreads; }
  void setThreads(int threads);
  /// Partitions of reductions do not depend on the number of threads.
  bool isDeterministic() const { return deterministic; }
  void setDeterministic(bool on) { deterministic = on; }

  /// Into how many parts a loop is cut: of `n` iterations that take `cost`
  /// nanoseconds each, by the estimate of the compiler or as measured.
  int64_t partition(int64_t n, double cost, bool reduces);
  /// Below this a fork does not pay even with workers that wait for it.
  static constexpr int64_t leastNs = 4000;
  /// Parts of work on so many bytes, some for each thread.
  int64_t partsOf(int64_t bytes, int64_t bytesPerPart) const {
    return std::clamp<int64_t>(bytes / bytesPerPart, 1,
                               2 * int64_t(numThreads));
  }

  /// Calls task(context, p) for p in [0, parts); and `look`, unless that is
  /// null, now and then while it waits for the workers.
  void parallel(int64_t parts, void (*task)(void *context, int64_t part),
                void *context, void (*look)(void *context) = nullptr);

  /// Loops that used workers, and those too small to pay for a fork.
  int64_t numForks() const { return forks.load(std::memory_order_relaxed); }
  int64_t numInline() const {
    return inlineLoops.load(std::memory_order_relaxed);
  }

private:
  WorkerPool &get();
  /// In a forked child the threads are not there.
  void leaveParent();

  int numThreads;
  bool deterministic;
  std::unique_ptr<ForkGuard> forkGuard;
  std::unique_ptr<WorkerPool> pool;
  std::mutex mutex;
  std::atomic<WorkerPool *> current{nullptr};
  std::atomic<int64_t> inlineCredit{0};
  std::atomic<int64_t> forks{0}, inlineLoops{0};
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_THREADS_WORKERS_H
