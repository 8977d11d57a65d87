//===- LoopTimes.h - What the loops of a kernel cost ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The compiler's estimate of an iteration is right within a factor of some ten:
// it does not know what will be vectorised, or what lies in a cache. Loops that
// are about as long as it takes to hand them to other cores are measured when
// they first run, and whether they are cut goes by that.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_LOOPTIMES_H
#define TAI_RUNTIME_LAUNCH_LOOPTIMES_H

#include <array>
#include <atomic>
#include <cstdint>

namespace mlir::tai::runtime {

/// The loops of one kernel, told apart by their estimates. Any thread.
class LoopTimes {
public:
  class Entry {
  public:
    /// Whether the loop should run in one part now, to be measured.
    bool wantsRun() const {
      uint32_t runs = count.load(std::memory_order_relaxed);
      return runs < firstRuns || runs % interval == 0;
    }
    /// To be called whenever the loop is about to run.
    void noteRun() { count.fetch_add(1, std::memory_order_relaxed); }
    /// Nanoseconds of an iteration; 0 before the first measurement.
    double perIteration() const {
      return nanoseconds.load(std::memory_order_relaxed);
    }
    /// A run on one core took so long. What other processes take of a core, or
    /// memory that is not there yet, can only add to it: the shortest counts,
    /// and others move it a little.
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

  /// The entry of a loop whose iteration is said to take `estimate`
  /// nanoseconds; null where the kernel has too many.
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
