//===- Safepoint.cpp - Where running work looks up ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Safepoint.h"
#include "tai/Runtime/Thread.h"
#include <chrono>
#include <pthread.h>

using namespace mlir::tai::runtime;

std::atomic<uint64_t> tai_rt_tick{1};

namespace {
/// Counts while somebody looks. Never destroyed, since threads may look until
/// the very end of the process, and its thread is never waited for.
class Clock {
public:
  static Clock &get() {
    static auto *clock = new Clock;
    return *clock;
  }

  /// Called by all who have seen a new tick.
  void noteLook() {
    if (__builtin_expect(isLooked.exchange(true, std::memory_order_relaxed),
                         true) &&
        state.load(std::memory_order_acquire) == State::Counts)
      return;
    std::lock_guard<std::mutex> lock(mutex);
    if (state.load(std::memory_order_relaxed) == State::None)
      start();
    else
      wanted.notify_one();
  }

  std::atomic<safepoint::Handler> handler{nullptr};

private:
  enum class State { None, Counts, Stands };

  Clock() {
    // A child has no clock, and starts its own.
    pthread_atfork([] { get().mutex.lock(); }, [] { get().mutex.unlock(); },
                   [] {
                     get().state.store(State::None);
                     get().mutex.unlock();
                     safepoint::request();
                   });
  }

  /// The lock is held.
  void start() {
    state.store(State::Counts, std::memory_order_release);
    sigset_t all, old;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &old);
    pthread_t thread;
    if (pthread_create(&thread, nullptr, &run, this) == 0)
      pthread_detach(thread);
    else
      state.store(State::None, std::memory_order_relaxed);
    pthread_sigmask(SIG_SETMASK, &old, nullptr);
  }

  static void *run(void *self) {
    pthread_setname_np(pthread_self(), "tai-clock");
    static_cast<Clock *>(self)->count();
    return nullptr;
  }

  void count() {
    constexpr auto interval = std::chrono::milliseconds(20);
    std::unique_lock<std::mutex> lock(mutex);
    while (true) {
      lock.unlock();
      timespec pause = {0, std::chrono::nanoseconds(interval).count()};
      nanosleep(&pause, nullptr);
      lock.lock();
      bool looked = isLooked.exchange(false, std::memory_order_relaxed);
      if (!looked)
        state.store(State::Stands, std::memory_order_release);
      // Also before it stands still: the next one who comes by sees a new tick,
      // and sets the clock going.
      safepoint::request();
      if (looked)
        continue;
      wanted.wait(lock, [&] { return isLooked.load(); });
      state.store(State::Counts, std::memory_order_release);
    }
  }

  std::atomic<bool> isLooked{false};
  std::atomic<State> state{State::None};
  std::mutex mutex;
  std::condition_variable wanted;
};

thread_local bool runsPartsOfOthers = false;
thread_local const std::atomic<bool> *followed = nullptr;
} // namespace

void safepoint::setHandler(Handler handler) {
  Clock::get().handler.store(handler);
}

bool safepoint::look() {
  if (followed)
    return !followed->load(std::memory_order_relaxed);
  Clock &clock = Clock::get();
  clock.noteLook();
  Handler handler = clock.handler.load(std::memory_order_relaxed);
  return !handler || runsPartsOfOthers || handler();
}

void safepoint::enterWorker() { runsPartsOfOthers = true; }

void safepoint::follow(const std::atomic<bool> *isCancelled) {
  followed = isCancelled;
}

bool safepoint::isWorker() { return runsPartsOfOthers; }
