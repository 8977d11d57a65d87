//===- Thread.h - A thread that is always joined ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Like std::thread, for code without exceptions: `start` returns false if the
// system cannot create a thread, instead of throwing, and the destructor joins
// instead of terminating the process.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_SUPPORT_THREAD_H
#define TAI_SUPPORT_THREAD_H

#include <functional>
#include <pthread.h>
#include <signal.h>
#include <utility>

namespace mlir::tai::runtime {

class Thread {
public:
  Thread() = default;
  Thread(Thread &&other) noexcept
      : handle(other.handle),
        isJoinable(std::exchange(other.isJoinable, false)) {}
  Thread &operator=(Thread &&other) noexcept {
    if (this == &other)
      return *this;
    join();
    handle = other.handle;
    isJoinable = std::exchange(other.isJoinable, false);
    return *this;
  }
  ~Thread() { join(); }

  /// Runs the task on a new thread with all signals blocked, so that signals go
  /// to the program's own threads. False, with nothing run, if no thread can be
  /// created.
  bool start(std::function<void()> task, const char *name) {
    join();
    auto *copy = new Task{std::move(task), name};
    sigset_t all, old;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &old);
    isJoinable = pthread_create(&handle, nullptr, &Thread::run, copy) == 0;
    pthread_sigmask(SIG_SETMASK, &old, nullptr);
    if (!isJoinable)
      delete copy;
    return isJoinable;
  }

  void join() {
    if (std::exchange(isJoinable, false))
      pthread_join(handle, nullptr);
  }

  /// Gives up the thread without joining it, in a forked child, where the
  /// thread does not exist.
  void forget() { isJoinable = false; }

private:
  struct Task {
    std::function<void()> run;
    const char *name;
  };
  static void *run(void *argument) {
    auto *task = static_cast<Task *>(argument);
    pthread_setname_np(pthread_self(), task->name);
    task->run();
    delete task;
    return nullptr;
  }

  pthread_t handle = {};
  bool isJoinable = false;
};

} // namespace mlir::tai::runtime

#endif // TAI_SUPPORT_THREAD_H
