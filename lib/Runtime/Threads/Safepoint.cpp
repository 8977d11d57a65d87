//===- Safepoint.cpp - Points of interruption -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Threads/Safepoint.h"
#include "tai/Runtime/Threads/Section.h"
#include "tai/Support/Thread.h"
#include <ctime>
#include <pthread.h>
#include <utility>

using namespace mlir::tai::runtime;

std::atomic<uint64_t> tai_rt_tick{1};
std::atomic<unsigned> safepoint::runningHandlers{0};

namespace {
/// The clock of safepoints, which counts ticks while threads look at them. If
/// no thread has looked since the last tick, the clock's thread makes one more
/// tick and ends; a thread that sees this tick starts a new one. Never
/// destroyed, since threads may look until the very end of the process.
class Clock {
public:
  static Clock &get() {
    static auto *clock = new Clock;
    return *clock;
  }

  /// Notes that some thread checks the clock of safepoints, and starts the
  /// clock if it has stopped. Called by each thread that has seen a new tick.
  void noteLook() {
    if (isLooked.exchange(true, std::memory_order_relaxed) &&
        isCounting.load(std::memory_order_acquire))
      return;
    std::lock_guard<std::mutex> lock(mutex);
    if (isCounting.load(std::memory_order_relaxed) || isStopped)
      return;
    isCounting.store(true, std::memory_order_release);
    if (!thread.start([this] { count(); }, "tai-clock"))
      isCounting.store(false, std::memory_order_relaxed);
  }

  /// Stops the clock. Returns when the clock's thread has ended; no new one
  /// will be started.
  void stop() {
    {
      std::lock_guard<std::mutex> lock(mutex);
      isStopped = true;
    }
    thread.join();
  }

  std::atomic<safepoint::Handler> handler{nullptr};

private:
  Clock() {
    // A forked child does not have the clock's thread, and starts its own.
    pthread_atfork([] { get().mutex.lock(); }, [] { get().mutex.unlock(); },
                   [] {
                     Clock &clock = get();
                     clock.thread.forget();
                     clock.isCounting = false;
                     clock.mutex.unlock();
                     safepoint::request();
                   });
  }

  void count() {
    constexpr long interval = 20 * 1000 * 1000;
    while (true) {
      timespec pause = {0, interval};
      nanosleep(&pause, nullptr);
      std::lock_guard<std::mutex> lock(mutex);
      bool goesOn =
          isLooked.exchange(false, std::memory_order_relaxed) && !isStopped;
      if (!goesOn)
        isCounting.store(false, std::memory_order_release);
      safepoint::request();
      if (!goesOn)
        return;
    }
  }

  std::atomic<bool> isLooked{false}, isCounting{false};
  bool isStopped = false;
  std::mutex mutex;
  Thread thread;
};

thread_local bool runsPartsOfOthers = false;
thread_local const std::atomic<bool> *followed = nullptr;
thread_local unsigned handlersHere = 0;
/// The number of `Unstoppable` objects on this thread, and a flag that tells
/// whether one was asked to stop.
thread_local unsigned unstoppable = 0;
thread_local bool wasAskedToStop = false;
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
  if (!handler || runsPartsOfOthers)
    return true;
  ++handlersHere;
  runningHandlers.fetch_add(1, std::memory_order_relaxed);
  // `Unstoppable` objects of the interrupted work do not protect the work of
  // the handler itself.
  unsigned outer = std::exchange(unstoppable, 0);
  bool wasAsked = wasAskedToStop;
  bool goesOn = handler() != 0;
  unstoppable = outer;
  wasAskedToStop = wasAsked || !goesOn;
  runningHandlers.fetch_sub(1, std::memory_order_relaxed);
  --handlersHere;
  return goesOn || unstoppable > 0;
}

safepoint::Unstoppable::Unstoppable() {
  if (unstoppable++ == 0)
    wasAskedToStop = false;
}

safepoint::Unstoppable::~Unstoppable() { --unstoppable; }

bool safepoint::Unstoppable::wasAsked() {
  return unstoppable > 0 && wasAskedToStop;
}

unsigned safepoint::handlerDepth() { return handlersHere; }

void safepoint::stopClock() { Clock::get().stop(); }

void safepoint::enterWorker() { runsPartsOfOthers = true; }

void safepoint::follow(const std::atomic<bool> *isCancelled) {
  followed = isCancelled;
}

bool safepoint::isWorker() { return runsPartsOfOthers; }

Status mlir::tai::runtime::failAsInterruptedWork() {
  return Status::failure(
      StatusCode::Usage,
      "a signal handler needs what the call that it has interrupted is in the "
      "middle of: let it note that the signal has come, and do this when that "
      "call has returned");
}

uint32_t safepoint::threadNumber() {
  static std::atomic<uint32_t> last{0};
  static thread_local const uint32_t number = ++last;
  return number;
}
