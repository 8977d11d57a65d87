//===- Safepoint.h - Where running work looks up ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Long work (a launch, a reverse sweep, a compilation, a wait for a device)
// reaches a safepoint every few milliseconds. There the host may interrupt it,
// or take the chance to let its other threads run: Python handles its signals
// and gives up its lock.
//
// A clock thread counts ticks of 20 ms. Compiled code compares the tick with
// the one that its frame has seen, at the back edges of its loops
// (docs/decisions/0019-safepoints.md), and calls the runtime where they differ.
// The clock stands still while nobody looks at it, so an idle process is left
// alone.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_THREADS_SAFEPOINT_H
#define TAI_RUNTIME_THREADS_SAFEPOINT_H

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>

extern "C" {
/// The number of ticks so far. A symbol of the ABI: compiled code reads it.
extern std::atomic<uint64_t> tai_rt_tick;
}

namespace mlir::tai::runtime::safepoint {

/// What the host does at a safepoint, on the thread whose work has reached it.
/// Returns 0 to interrupt that work.
using Handler = int (*)();

/// One handler for the process; null for none.
void setHandler(Handler handler);

inline uint64_t now() { return tai_rt_tick.load(std::memory_order_relaxed); }

/// Makes all work look up at once. Safe in a signal handler.
inline void request() { tai_rt_tick.fetch_add(1, std::memory_order_relaxed); }

/// Asks the host. Returns false where the work of this thread is to end.
bool look();

/// The same for a place that is passed often: asks once a tick.
class Watch {
public:
  bool look() {
    uint64_t tick = now();
    if (__builtin_expect(tick == seen, true))
      return true;
    seen = tick;
    return safepoint::look();
  }

private:
  uint64_t seen = now();
};

/// Waits until `done()`, which `changed` announces, with safepoints between.
/// Returns false if the wait was interrupted; the lock is held either way.
template <typename Done>
bool wait(std::condition_variable &changed, std::unique_lock<std::mutex> &lock,
          const Done &done) {
  while (!changed.wait_for(lock, std::chrono::milliseconds(20), done)) {
    lock.unlock();
    bool goesOn = look();
    lock.lock();
    if (!goesOn)
      return done();
  }
  return true;
}

/// Takes a lock that another thread may hold for long. While it waits, the host
/// may let its other threads run, the holder among them. Not interrupted.
template <typename Mutex> void lock(Mutex &mutex) {
  if (mutex.try_lock())
    return;
  while (!mutex.try_lock_for(std::chrono::milliseconds(5)))
    (void)look();
}

/// Has taken such a lock, and gives it back. To be used for all that is held
/// where work may look up: whoever waits for it without doing so keeps the
/// host's own lock, for which the holder may wait meanwhile.
template <typename Mutex> class Guard {
public:
  explicit Guard(Mutex &mutex) : mutex(mutex) { safepoint::lock(mutex); }
  ~Guard() { mutex.unlock(); }
  Guard(const Guard &) = delete;
  Guard &operator=(const Guard &) = delete;

private:
  Mutex &mutex;
};

/// Ends the clock for good, before the end of the process.
void stopClock();

/// Says that the calling thread runs parts of others' work, and never asks.
void enterWorker();
/// Says that the calling thread, instead of asking, ends its work once the flag
/// is set, as whoever waits for it does then.
void follow(const std::atomic<bool> *isCancelled);
bool isWorker();

/// A number of the calling thread, not 0, which no other one has.
uint32_t threadNumber();

} // namespace mlir::tai::runtime::safepoint

#endif // TAI_RUNTIME_THREADS_SAFEPOINT_H
