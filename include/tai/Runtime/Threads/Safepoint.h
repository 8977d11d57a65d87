//===- Safepoint.h - Points of interruption ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Long work (a launch, a reverse sweep, a compilation, a wait for a device)
// reaches a safepoint every few milliseconds. At a safepoint the host may
// interrupt the work, or let other threads of the host run: Python handles
// signals and releases its lock (GIL).
//
// A clock thread counts ticks of 20 ms. Compiled code compares the tick with
// the tick in its frame, at the back edges of loops
// (docs/decisions/0019-safepoints.md), and calls the runtime if the two differ.
// The clock stops while no work polls it, so that an idle process has no
// wake-ups.
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
/// The number of clock ticks so far. A symbol of the ABI, which compiled code
/// reads.
extern std::atomic<uint64_t> tai_rt_tick;
}

namespace mlir::tai::runtime::safepoint {

/// The host's callback at a safepoint, on the thread that has reached it.
/// Returns 0 to interrupt the work of that thread.
using Handler = int (*)();

/// Sets the handler of the process; null removes it.
void setHandler(Handler handler);

inline uint64_t now() { return tai_rt_tick.load(std::memory_order_relaxed); }

/// Makes all work reach the slow path of its next safepoint. Safe in a signal
/// handler.
inline void request() { tai_rt_tick.fetch_add(1, std::memory_order_relaxed); }

/// Passes a safepoint: calls the host's handler. Returns false if the work of
/// this thread must stop.
bool look();

/// The number of handler calls that are active on this thread, one within
/// another.
unsigned handlerDepth();
/// The number of handlers that run on any thread.
extern std::atomic<unsigned> runningHandlers;
/// True if this thread runs a handler; costs one load while no thread runs one.
inline bool isInHandler() {
  return __builtin_expect(runningHandlers.load(std::memory_order_relaxed) != 0,
                          false) &&
         handlerDepth() != 0;
}

/// While an object of this class lives, safepoints of its thread call the
/// handler but never stop the work, because the work restores values and must
/// be completed. An interruption takes effect afterwards.
class Unstoppable {
public:
  Unstoppable();
  ~Unstoppable();
  Unstoppable(const Unstoppable &) = delete;
  Unstoppable &operator=(const Unstoppable &) = delete;

  /// True if the host has asked to stop the work of the innermost Unstoppable.
  /// A wait for a kernel can then end the kernel.
  static bool wasAsked();
};

/// A safepoint for places that are passed often: calls the handler at most once
/// in a tick.
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

/// Waits on the condition variable `changed` until `done()` is true, with
/// safepoints in between. Returns false if the wait was interrupted; `lock` is
/// held on return in either case.
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

/// Locks a mutex that another thread may hold for long, with safepoints in
/// between, so that the host can let the owner of the mutex run. Cannot be
/// interrupted.
template <typename Mutex> void lock(Mutex &mutex) {
  if (mutex.try_lock())
    return;
  while (!mutex.try_lock_for(std::chrono::milliseconds(5)))
    (void)look();
}

/// Holds a mutex for its lifetime, locked by `lock`. Must be used for every
/// mutex that is held across safepoints: a thread that blocked on such a mutex
/// would keep the host's own lock, for which the owner of the mutex may wait.
template <typename Mutex> class Guard {
public:
  explicit Guard(Mutex &mutex) : mutex(mutex) { safepoint::lock(mutex); }
  ~Guard() { mutex.unlock(); }
  Guard(const Guard &) = delete;
  Guard &operator=(const Guard &) = delete;

private:
  Mutex &mutex;
};

/// Stops the tick clock permanently, before the process exits.
void stopClock();

/// Marks the calling thread as a worker, whose safepoints never call the
/// handler.
void enterWorker();
/// Makes the safepoints of the calling thread check the flag instead of calling
/// the host's handler: the work of the thread stops once the flag is set.
void follow(const std::atomic<bool> *isCancelled);
bool isWorker();

/// A unique non-zero number of the calling thread.
uint32_t threadNumber();

} // namespace mlir::tai::runtime::safepoint

#endif // TAI_RUNTIME_THREADS_SAFEPOINT_H
