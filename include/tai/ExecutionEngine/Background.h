//===- Background.h - Work ahead of need ------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Runs jobs whose results will probably be wanted, on cores that would idle.
// Who wants a result that is not there yet takes the job over, or waits for it.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_BACKGROUND_H
#define TAI_EXECUTIONENGINE_BACKGROUND_H

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
    /// Nobody will look at what becomes of it.
    std::atomic<bool> isAbandoned{false};
  };
  using JobPtr = std::shared_ptr<Job>;

  /// Threads that have no job sleep until there is one: what MLIR keeps for
  /// each thread stays until the end of the context, 4 KiB for every kind of
  /// attribute that it makes. A fork waits for the jobs that run, so that no
  /// child inherits half a job, and ends the threads; so does the end of the
  /// process, at which code and data that they use go.
  explicit Background(unsigned maxThreads);
  ~Background();
  Background(const Background &) = delete;
  Background &operator=(const Background &) = delete;

  /// Waits for the jobs that run. Those that wait, and all later ones, are left
  /// to finish(), but for what nobody else would do.
  void stop();
  /// The same for all that there are.
  static void stopAll();

  /// Without threads to run it on, the job waits for finish().
  JobPtr start(std::function<void()> task);
  /// The same for what nobody will finish(): at the latest, it is done when the
  /// threads are stopped.
  void doLater(std::function<void()> task);

  /// Returns once the job is done; runs it here if it has not begun. False if
  /// it runs elsewhere and the wait for it was interrupted at a safepoint.
  bool finish(Job &job);

  /// Runs a job at once, on a thread of its own if there is one to be had, and
  /// waits for it. False, with the job still running, if that was interrupted
  /// at a safepoint.
  bool runAside(std::function<void()> task);

  /// What is wanted of a job that waits for something outside of the process:
  /// to wait on, to do without, or to end at once. Asked on the thread that
  /// runs the job, or on one that has no job and passes safepoints.
  enum class Wish { Wait, Hurry, Abandon };
  static Wish getWish();

  /// Drops the job if it has not begun, else waits for it.
  void cancel(Job &job);

private:
  friend struct BackgroundForks;
  /// As many threads sleep, no more.
  static constexpr unsigned kMostIdle = 16;

  void run(std::list<runtime::Thread>::iterator self);
  /// Has one more thread look for a job, if it may; the lock is held.
  bool callThread();
  /// What a thread does next, or null; the lock is held.
  JobPtr takeNext();
  unsigned numThreads() const { return threads.size(); }
  unsigned numBusy() const { return numThreads() - idle; }
  JobPtr add(std::function<void()> task, bool isNeeded);
  /// Runs the task of a job, which says meanwhile what is wanted of it.
  void perform(Job &job);
  /// Runs a job that nobody else runs; the lock is held, but while it runs.
  void runHere(Job &job, std::unique_lock<std::mutex> &lock);
  /// Waits until all threads have ended, which they have been told to.
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
  /// A thread that sleeps is to look for a job.
  std::condition_variable called;
  std::deque<JobPtr> queue;
  /// What runs at once, by whom somebody waits; each has called a thread.
  std::deque<JobPtr> asides;
  std::list<runtime::Thread> threads;
  /// Those that have ended, or are about to, and hold no lock any more.
  std::list<runtime::Thread> ended;
  unsigned idle = 0;
  /// Threads that were called and have not woken up yet.
  unsigned calls = 0;
  /// Threads end after the job that they run.
  std::atomic<bool> isHeld{false};
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_BACKGROUND_H
