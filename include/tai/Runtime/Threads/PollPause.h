//===- PollPause.h - Pauses between the polls of a wait ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_THREADS_POLLPAUSE_H
#define TAI_RUNTIME_THREADS_POLLPAUSE_H

#include <algorithm>
#include <chrono>
#include <thread>

namespace mlir::tai::runtime {

/// Tells the processor that this thread is spinning.
inline void pauseCpu() {
#if defined(__x86_64__) || defined(__i386__)
  __builtin_ia32_pause();
#elif defined(__aarch64__)
  asm volatile("yield");
#endif
}

/// Pauses between the polls of one wait for a device. The thread never yields
/// its core: where other threads want it, Linux gives it back after a tick of
/// 4 ms or several, and a wait of 0.1 ms takes 4, 8 or 12. So a short wait
/// spins, and a long wait sleeps for a small part of its time so far.
class PollPause {
public:
  using Duration = std::chrono::steady_clock::duration;

  /// The time to sleep in a wait for a device that has taken `waited`; zero to
  /// spin.
  static Duration sleepAfter(Duration waited) {
    using namespace std::chrono_literals;
    constexpr Duration spinFor = 20ms, longest = 5ms;
    constexpr int part = 256;
    return waited < spinFor ? Duration::zero()
                            : std::min<Duration>(waited / part, longest);
  }

  void operator()() {
    auto now = std::chrono::steady_clock::now();
    if (begin == std::chrono::steady_clock::time_point())
      begin = now;
    Duration sleep = sleepAfter(now - begin);
    if (sleep == Duration::zero())
      pauseCpu();
    else
      std::this_thread::sleep_for(sleep);
  }

private:
  std::chrono::steady_clock::time_point begin;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_THREADS_POLLPAUSE_H
