//===- Thread.h - A thread that is always waited for ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What std::thread would be in code without exceptions: it says that the system
// gives no more threads instead of throwing through frames that do not unwind,
// and one that goes out of scope is joined instead of ending the process.
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

  /// Runs the task on a thread of its own, which receives no signals: those
  /// belong to the threads of the program. False, with nothing run, where there
  /// are no more threads.
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

  /// Of a forked child, which has no other threads: there is nothing to join.
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
