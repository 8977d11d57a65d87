//===- Background.cpp - Speculative background jobs -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Compile/Background.h"
#include "tai/Runtime/Threads/Safepoint.h"
#include "llvm/ADT/STLExtras.h"
#include <cstdlib>
#include <pthread.h>
#include <vector>

using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Background threads at a fork, and at the end of the process
//===----------------------------------------------------------------------===//

namespace mlir::tai {
/// The list of all objects of class Background. It is never destroyed, because
/// threads may end after static objects are destroyed.
struct BackgroundForks {
  std::mutex mutex;
  std::vector<Background *> all;

  static BackgroundForks &get() {
    static auto *forks = [] {
      pthread_atfork(&prepare, &inParent, &inChild);
      std::atexit(&Background::stopAll);
      return new BackgroundForks;
    }();
    return *forks;
  }

private:
  static void prepare() {
    get().mutex.lock();
    for (Background *background : get().all)
      background->hold();
  }
  static void leave(bool inChild) {
    for (Background *background : get().all)
      background->release(inChild);
    get().mutex.unlock();
  }
  static void inParent() { leave(/*inChild=*/false); }
  static void inChild() { leave(/*inChild=*/true); }
};
} // namespace mlir::tai

/// Ends all threads of the object, and returns with its lock held, before a
/// fork.
void Background::hold() {
  std::unique_lock<std::mutex> lock(mutex);
  isHeld = true;
  endThreads(lock);
  lock.release();
}

void Background::release(bool inChild) {
  isHeld = false;
  // A child of a fork runs queued jobs itself when it needs their results.
  if (!inChild && !queue.empty())
    callThread();
  mutex.unlock();
}

void Background::stopAll() {
  BackgroundForks &forks = BackgroundForks::get();
  std::lock_guard<std::mutex> lock(forks.mutex);
  for (Background *background : forks.all)
    background->stop();
}

//===----------------------------------------------------------------------===//
// Background
//===----------------------------------------------------------------------===//

Background::Background(unsigned maxThreads) : maxThreads(maxThreads) {
  BackgroundForks &forks = BackgroundForks::get();
  std::lock_guard<std::mutex> lock(forks.mutex);
  forks.all.push_back(this);
}

Background::~Background() {
  {
    BackgroundForks &forks = BackgroundForks::get();
    std::lock_guard<std::mutex> lock(forks.mutex);
    forks.all.erase(llvm::find(forks.all, this));
  }
  stop();
}

void Background::stop() {
  std::unique_lock<std::mutex> lock(mutex);
  maxThreads = 0;
  endThreads(lock);
  std::deque<JobPtr> waiting = queue;
  for (const JobPtr &job : waiting)
    if (job->isNeeded && take(*job))
      runHere(*job, lock);
}

void Background::endThreads(std::unique_lock<std::mutex> &lock) {
  called.notify_all();
  changed.wait(lock, [&] { return numThreads() == 0; });
  ended.clear();
}

bool Background::callThread() {
  if (isHeld || maxThreads == 0)
    return false;
  if (idle > 0) {
    --idle;
    ++calls;
    called.notify_one();
    return true;
  }
  ended.clear();
  threads.emplace_front();
  auto self = threads.begin();
  // If no more threads can be started, the caller of finish() runs the job.
  if (self->start([this, self] { run(self); }, "tai-compile"))
    return true;
  threads.erase(self);
  return false;
}

Background::JobPtr Background::start(std::function<void()> task) {
  return add(std::move(task), /*isNeeded=*/false);
}

void Background::doLater(std::function<void()> task) {
  add(std::move(task), /*isNeeded=*/true);
}

Background::JobPtr Background::add(std::function<void()> task, bool isNeeded) {
  auto job = std::make_shared<Job>();
  job->task = std::move(task);
  job->isNeeded = isNeeded;
  std::lock_guard<std::mutex> lock(mutex);
  queue.push_back(job);
  if (numBusy() < maxThreads)
    callThread();
  return job;
}

Background::JobPtr Background::takeNext() {
  JobPtr job;
  bool goesOn = maxThreads > 0 && !isHeld && numBusy() <= maxThreads;
  for (std::deque<JobPtr> *jobs : {&asides, &queue}) {
    if (jobs->empty() || (jobs == &queue && !goesOn))
      continue;
    job = std::move(jobs->front());
    jobs->pop_front();
    break;
  }
  return job;
}

void Background::run(std::list<runtime::Thread>::iterator self) {
  runtime::safepoint::enterWorker();
  std::unique_lock<std::mutex> lock(mutex);
  while (true) {
    if (JobPtr job = takeNext()) {
      job->state = Job::State::Running;
      lock.unlock();
      perform(*job);
      lock.lock();
      job->state = Job::State::Done;
      changed.notify_all();
      continue;
    }
    if (isHeld || maxThreads == 0 || idle == kMostIdle)
      break;
    ++idle;
    called.wait(lock, [&] { return calls > 0 || isHeld || maxThreads == 0; });
    // If `calls` is positive, callThread has already removed this thread from
    // the idle ones.
    if (calls > 0)
      --calls;
    else
      --idle;
  }
  // The lock is still held, so a job that is added from now on starts another
  // thread.
  ended.splice(ended.begin(), threads, self);
  changed.notify_all();
}

bool Background::take(Job &job) {
  auto found = llvm::find_if(
      queue, [&](const JobPtr &other) { return other.get() == &job; });
  if (found == queue.end())
    return false;
  queue.erase(found);
  return true;
}

bool Background::waitFor(Job &job, std::unique_lock<std::mutex> &lock) {
  return runtime::safepoint::wait(
      changed, lock, [&] { return job.state == Job::State::Done; });
}

bool Background::finish(Job &job) {
  std::unique_lock<std::mutex> lock(mutex);
  if (!take(job))
    return waitFor(job, lock);
  runHere(job, lock);
  return true;
}

bool Background::runAside(std::function<void()> task) {
  auto job = std::make_shared<Job>();
  job->task = std::move(task);
  std::unique_lock<std::mutex> lock(mutex);
  if (!callThread()) {
    runHere(*job, lock);
    return true;
  }
  asides.push_back(job);
  if (waitFor(*job, lock))
    return true;
  job->isAbandoned = true;
  return false;
}

/// The job that the calling thread runs, and the Background object of that job.
static thread_local const Background::Job *currentJob = nullptr;
static thread_local const Background *currentOwner = nullptr;

void Background::perform(Job &job) {
  currentJob = &job;
  currentOwner = this;
  job.task();
  // The task is destroyed at this point, because its destructor may cancel
  // other jobs and so take the lock, which the thread that joins this thread
  // later holds.
  job.task = nullptr;
  currentJob = nullptr;
}

Background::Wish Background::getWish() {
  if (!currentJob)
    return runtime::safepoint::look() ? Wish::Wait : Wish::Abandon;
  if (currentJob->isAbandoned)
    return Wish::Abandon;
  return currentOwner->isHeld || currentOwner->maxThreads == 0 ? Wish::Hurry
                                                               : Wish::Wait;
}

void Background::runHere(Job &job, std::unique_lock<std::mutex> &lock) {
  job.state = Job::State::Running;
  lock.unlock();
  job.task();
  job.task = nullptr;
  lock.lock();
  job.state = Job::State::Done;
  changed.notify_all();
}

void Background::cancel(Job &job) {
  std::unique_lock<std::mutex> lock(mutex);
  job.isAbandoned = true;
  if (take(job))
    job.state = Job::State::Done;
  else
    changed.wait(lock, [&] { return job.state == Job::State::Done; });
}
