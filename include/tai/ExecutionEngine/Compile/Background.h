//===- Background.h - Speculative background jobs ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Runs jobs whose results will probably be needed, on idle cores. A caller that
// needs a result runs the job itself if it has not begun, or waits for it.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_COMPILE_BACKGROUND_H
#define TAI_EXECUTIONENGINE_COMPILE_BACKGROUND_H

#include "tai/Support/Thread.h"
#include <atomic>
#include <condition_variable>
#include <deque>
#include <functional>
#include <list>
#include <memory>
#include <mutex>

namespace mlir::tai {

class Background {
public:
  class Job {
    friend class Background;
    enum class State { Queued, Running, Done };
    std::function<void()> task;
    State state = State::Queued;
    bool isNeeded = false;
    /// No caller will use the result of the job.
    std::atomic<bool> isAbandoned{false};
  };
  using JobPtr = std::shared_ptr<Job>;

  /// Threads without a job sleep and are reused: MLIR's per-thread storage
  /// lives until the end of the context, 4 KiB for every kind of attribute.
  /// fork() waits for running jobs, so that no child inherits half a job, and
  /// joins the threads; so does process exit, before code and data that they
  /// use are destroyed.
  explicit Background(unsigned maxThreads);
  ~Background();
  Background(const Background &) = delete;
  Background &operator=(const Background &) = delete;

  /// Waits for running jobs. Queued jobs and all later jobs run in finish()
  /// only, except jobs of doLater().
  void stop();
  /// Calls stop() on all instances.
  static void stopAll();

  /// Queues a job. Without threads, it runs in finish().
  JobPtr start(std::function<void()> task);
  /// Queues a job for which nobody calls finish(); it is done at the latest
  /// when the threads are stopped.
  void doLater(std::function<void()> task);

  /// Returns once the job is done; runs it here if it has not begun. False if
  /// it runs on another thread and the wait was interrupted at a safepoint.
  bool finish(Job &job);

  /// Runs a job at once, on a thread of its own if one is available, and waits
  /// for it. False, with the job still running, if the wait was interrupted at
  /// a safepoint.
  bool runAside(std::function<void()> task);

  /// The way in which a job waits for something outside of the process: keep
  /// waiting, stop waiting and do without, or return at once. Queried on the
  /// thread that runs the job, or on a thread without a job, which passes
  /// safepoints.
  enum class Wish { Wait, Hurry, Abandon };
  static Wish getWish();

  /// Drops the job if it has not begun, else waits for it.
  void cancel(Job &job);

private:
  friend struct BackgroundForks;
  /// The maximum of sleeping threads.
  static constexpr unsigned kMostIdle = 16;

  void run(std::list<runtime::Thread>::iterator self);
  /// Wakes or creates a thread to look for a job, if allowed; the lock is held.
  bool callThread();
  /// The next job of a thread, or null; the lock is held.
  JobPtr takeNext();
  unsigned numThreads() const { return threads.size(); }
  unsigned numBusy() const { return numThreads() - idle; }
  JobPtr add(std::function<void()> task, bool isNeeded);
  /// Runs the task of a job, with the job current for getWish().
  void perform(Job &job);
  /// Runs a job that no other thread runs; the lock is held, except while it
  /// runs.
  void runHere(Job &job, std::unique_lock<std::mutex> &lock);
  /// Waits until all threads have ended, after they were asked to end.
  void endThreads(std::unique_lock<std::mutex> &lock);
  void hold();
  void release(bool inChild);
  bool waitFor(Job &job, std::unique_lock<std::mutex> &lock);
  /// Takes the job from the queue; false if it has begun.
  bool take(Job &job);

  std::atomic<unsigned> maxThreads;
  std::mutex mutex;
  /// A job is done, or a thread has ended.
  std::condition_variable changed;
  /// A sleeping thread shall look for a job.
  std::condition_variable called;
  std::deque<JobPtr> queue;
  /// The jobs of runAside(). For each such job, a thread was called.
  std::deque<JobPtr> asides;
  std::list<runtime::Thread> threads;
  /// Threads that have ended or are about to, and hold no lock any more.
  std::list<runtime::Thread> ended;
  unsigned idle = 0;
  /// Threads that were called and have not woken up yet.
  unsigned calls = 0;
  /// Whether threads end after the job that they run.
  std::atomic<bool> isHeld{false};
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_COMPILE_BACKGROUND_H
