//===- LoopTimes.h - Times of a kernel's loops ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The compiler's estimate of an iteration is right within a factor of about
// ten: it does not foresee vectorisation and caches. Loops whose estimate is
// close to the cost of a fork are timed when they first run, and the
// measurement decides whether they are parallelised.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_LOOPTIMES_H
#define TAI_RUNTIME_LAUNCH_LOOPTIMES_H

#include <array>
#include <atomic>
#include <cstdint>

namespace mlir::tai::runtime {

/// The times of one kernel's loops, identified by their estimates. Thread-safe.
class LoopTimes {
public:
  class Entry {
  public:
    /// True if the next run of the loop should be on one core, to be timed.
    bool wantsRun() const {
      uint32_t runs = count.load(std::memory_order_relaxed);
      return runs < firstRuns || runs % interval == 0;
    }
    /// Counts a run of the loop. Must be called before each run.
    void noteRun() { count.fetch_add(1, std::memory_order_relaxed); }
    /// The measured nanoseconds for one iteration of the loop; 0 before the
    /// first measurement.
    double perIteration() const {
      return nanoseconds.load(std::memory_order_relaxed);
    }
    /// Adds a measurement of a run on one core, in nanoseconds for an
    /// iteration. Other processes and page faults can only lengthen a run, so
    /// the minimum counts, and longer times move the result slightly.
    void add(double perIteration) {
      double old = nanoseconds.load(std::memory_order_relaxed);
      double next = old == 0 || perIteration < old
                        ? perIteration
                        : old + (perIteration - old) / 16;
      nanoseconds.store(next, std::memory_order_relaxed);
    }

  private:
    friend class LoopTimes;
    static constexpr uint32_t firstRuns = 4, interval = 256;
    std::atomic<int64_t> estimate{0};
    std::atomic<double> nanoseconds{0};
    std::atomic<uint32_t> count{0};
  };

  /// Returns the entry of the loop with this estimate, in nanoseconds for an
  /// iteration; null if the kernel has too many loops.
  Entry *find(int64_t estimate) {
    for (Entry &entry : entries) {
      int64_t known = entry.estimate.load(std::memory_order_relaxed);
      if (known == 0 && entry.estimate.compare_exchange_strong(
                            known, estimate, std::memory_order_relaxed))
        return &entry;
      if (known == estimate)
        return &entry;
    }
    return nullptr;
  }

private:
  std::array<Entry, 6> entries;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_LOOPTIMES_H
