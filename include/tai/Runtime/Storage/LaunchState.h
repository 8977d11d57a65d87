//===- LaunchState.h - For what prepared launches hold ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A launch that has been prepared goes its short way as long as one number is
// the one that it was prepared for. This is who changes that number.
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
  /// Where launches look: the epoch, or `never`.
  static constexpr uint64_t never = UINT64_MAX;
  void publishTo(std::atomic<uint64_t> &place) {
    std::lock_guard<std::mutex> lock(mutex);
    published = &place;
    update();
  }

  /// The number of the state of the storage: another one where a tree has gone
  /// or an adjoint has come. Kernels then look again.
  uint64_t epoch() const { return current.load(std::memory_order_relaxed); }
  void storageChanged() {
    std::lock_guard<std::mutex> lock(mutex);
    current.fetch_add(1, std::memory_order_relaxed);
    update();
  }

  /// Between the two, launches do more than to call code: a tape records, say.
  /// Pairs nest.
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
