//===- LaunchState.h - The validity of prepared launches --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Owns the number that tells whether prepared launches are still valid: a
// prepared launch is valid as long as this number is unchanged.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_STORAGE_LAUNCHSTATE_H
#define TAI_RUNTIME_STORAGE_LAUNCHSTATE_H

#include <atomic>
#include <cstdint>
#include <mutex>

namespace mlir::tai::runtime {

class LaunchState {
public:
  /// Sets the variable where launches read the state number. The variable then
  /// holds the epoch, or `never` while launches need extra steps.
  static constexpr uint64_t never = UINT64_MAX;
  void publishTo(std::atomic<uint64_t> &place) {
    std::lock_guard<std::mutex> lock(mutex);
    published = &place;
    update();
  }

  /// The epoch of the storage, which changes when a tree is destroyed or an
  /// adjoint is added. Kernels then bind their fields again.
  uint64_t epoch() const { return current.load(std::memory_order_relaxed); }
  void storageChanged() {
    std::lock_guard<std::mutex> lock(mutex);
    current.fetch_add(1, std::memory_order_relaxed);
    update();
  }

  /// Bracket a period in which launches need more steps than the call of the
  /// kernel's code, for example while a tape records. Calls nest.
  void beginSpecial() { countSpecial(1); }
  void endSpecial() { countSpecial(-1); }
  bool isSpecial() const {
    return specials.load(std::memory_order_relaxed) != 0;
  }

private:
  void countSpecial(int by) {
    std::lock_guard<std::mutex> lock(mutex);
    specials.fetch_add(by, std::memory_order_relaxed);
    update();
  }
  void update() {
    if (published)
      published->store(isSpecial() ? never : epoch(),
                       std::memory_order_relaxed);
  }

  std::mutex mutex;
  std::atomic<uint64_t> current{1};
  std::atomic<int> specials{0};
  std::atomic<uint64_t> *published = nullptr;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_STORAGE_LAUNCHSTATE_H
