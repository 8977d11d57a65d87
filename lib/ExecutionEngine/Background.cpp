//===- Background.cpp - Work ahead of need --------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Background.h"
#include <algorithm>

using namespace mlir::tai;

Background::~Background() {
  {
    std::lock_guard<std::mutex> lock(mutex);
    queue.clear();
  }
  for (std::thread &thread : threads)
    thread.join();
}

Background::JobPtr Background::start(std::function<void()> task) {
  auto job = std::make_shared<Job>();
  job->task = std::move(task);
  std::lock_guard<std::mutex> lock(mutex);
  queue.push_back(job);
  if (running == 0) {
    // They have ended, or are about to.
    for (std::thread &thread : threads)
      thread.join();
    threads.clear();
  }
  if (running < maxThreads) {
    ++running;
    threads.emplace_back([this] { run(); });
  }
  return job;
}

void Background::run() {
  std::unique_lock<std::mutex> lock(mutex);
  while (!queue.empty()) {
    JobPtr job = std::move(queue.front());
    queue.pop_front();
    job->state = Job::State::Running;
    lock.unlock();
    job->task();
    lock.lock();
    job->state = Job::State::Done;
    changed.notify_all();
  }
  // Under the lock, so that a job which comes now starts another thread.
  --running;
}

bool Background::take(Job &job) {
  auto found =
      std::find_if(queue.begin(), queue.end(),
                   [&](const JobPtr &other) { return other.get() == &job; });
  if (found == queue.end())
    return false;
  queue.erase(found);
  return true;
}

void Background::waitFor(Job &job, std::unique_lock<std::mutex> &lock) {
  changed.wait(lock, [&] { return job.state == Job::State::Done; });
}

void Background::finish(Job &job) {
  std::unique_lock<std::mutex> lock(mutex);
  if (!take(job))
    return waitFor(job, lock);
  job.state = Job::State::Running;
  lock.unlock();
  job.task();
  lock.lock();
  job.state = Job::State::Done;
  changed.notify_all();
}

void Background::cancel(Job &job) {
  std::unique_lock<std::mutex> lock(mutex);
  if (take(job))
    job.state = Job::State::Done;
  else
    waitFor(job, lock);
}
