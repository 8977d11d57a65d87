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
    /// True if no caller will use the result of the job any more.
    std::atomic<bool> isAbandoned{false};
  };
  using JobPtr = std::shared_ptr<Job>;

  /// Starts with no threads. Threads without a job sleep and are reused: MLIR's
  /// per-thread storage lives until the end of the context, 4 KiB for every
  /// kind of attribute. fork() waits for running jobs, so that no child process
  /// inherits a job half done, and joins the threads; so does process exit,
  /// before code and data that the threads use are destroyed.
  explicit Background(unsigned maxThreads);
  ~Background();
  Background(const Background &) = delete;
  Background &operator=(const Background &) = delete;

  /// Waits for running jobs, and lets no thread start another job. Queued jobs
  /// and all later jobs run in finish() only, except jobs of doLater().
  void stop();
  /// Calls stop() on all instances of Background.
  static void stopAll();

  /// Queues a job for a background thread. If there are no threads, the job
  /// runs in finish().
  JobPtr start(std::function<void()> task);
  /// Queues a job for which no caller will call finish(). The job is done at
  /// the latest when the threads are stopped.
  void doLater(std::function<void()> task);

  /// Returns once the job is done; runs it on the calling thread if it has not
  /// begun. False if the job runs on another thread and the wait was
  /// interrupted at a safepoint.
  bool finish(Job &job);

  /// Runs a task at once, on another thread if one is available, and waits for
  /// its end. False, with the task still running, if the wait was interrupted
  /// at a safepoint.
  bool runAside(std::function<void()> task);

  /// The way in which a job waits for something outside of the process: keep
  /// waiting, stop waiting and do without, or return at once. Queried on the
  /// thread that runs the job, or on a thread without a job, which passes
  /// safepoints.
  enum class Wish { Wait, Hurry, Abandon };
  static Wish getWish();

  /// Drops a job that has not begun, or waits for the end of a running job.
  void cancel(Job &job);

private:
  friend struct BackgroundForks;
  /// The most threads that sleep while they wait for jobs; further threads end.
  static constexpr unsigned kMostIdle = 16;

  void run(std::list<runtime::Thread>::iterator self);
  /// Wakes or creates a thread that will look for a job, if another thread is
  /// allowed. The caller holds the lock.
  bool callThread();
  /// Takes the next job for a thread, or null. The caller holds the lock.
  JobPtr takeNext();
  unsigned numThreads() const { return threads.size(); }
  unsigned numBusy() const { return numThreads() - idle; }
  JobPtr add(std::function<void()> task, bool isNeeded);
  /// Runs the task of a job, as the job about which getWish() returns
  /// information.
  void perform(Job &job);
  /// Runs a job, which no other thread runs, on the calling thread. The caller
  /// holds the lock, which is released while the job runs.
  void runHere(Job &job, std::unique_lock<std::mutex> &lock);
  /// Waits until all threads, which have been asked to end, have ended.
  void endThreads(std::unique_lock<std::mutex> &lock);
  void hold();
  void release(bool inChild);
  bool waitFor(Job &job, std::unique_lock<std::mutex> &lock);
  /// Removes a job from the queue; false if the job has begun.
  bool take(Job &job);

  std::atomic<unsigned> maxThreads;
  std::mutex mutex;
  /// Signals that a job is done, or that a thread has ended.
  std::condition_variable changed;
  /// Signals that a sleeping worker thread shall look for a job.
  std::condition_variable called;
  std::deque<JobPtr> queue;
  /// The jobs of runAside(), which do not wait until other jobs have run. A
  /// thread was started for each of them.
  std::deque<JobPtr> asides;
  std::list<runtime::Thread> threads;
  /// Threads that have ended or are about to end, and hold no lock any more.
  std::list<runtime::Thread> ended;
  unsigned idle = 0;
  /// The number of threads that were called and have not woken up yet.
  unsigned calls = 0;
  /// True while each thread ends after the job that it is running, as before a
  /// fork.
  std::atomic<bool> isHeld{false};
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_COMPILE_BACKGROUND_H
