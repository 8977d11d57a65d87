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

#include <condition_variable>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

namespace mlir::tai {

class Background {
public:
  class Job {
    friend class Background;
    enum class State { Queued, Running, Done };
    std::function<void()> task;
    State state = State::Queued;
  };
  using JobPtr = std::shared_ptr<Job>;

  /// Threads live only while there are jobs: an idle process has none, which
  /// is also what makes it safe to fork.
  explicit Background(unsigned maxThreads) : maxThreads(maxThreads) {}
  ~Background();

  /// Without threads to run it on, the job waits for finish().
  JobPtr start(std::function<void()> task);

  /// Returns once the job is done; runs it here if it has not begun.
  void finish(Job &job);

  /// Drops the job if it has not begun, else waits for it.
  void cancel(Job &job);

private:
  void run();
  void waitFor(Job &job, std::unique_lock<std::mutex> &lock);
  /// Takes the job from the queue; false if it has begun.
  bool take(Job &job);

  const unsigned maxThreads;
  std::mutex mutex;
  std::condition_variable changed;
  std::deque<JobPtr> queue;
  std::vector<std::thread> threads;
  unsigned running = 0;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_BACKGROUND_H
