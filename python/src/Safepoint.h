//===- Safepoint.h - Python's lock and signals in long calls ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A call of libtai begins with Python's lock (GIL) held, and most end within
// microseconds. A longer one reaches safepoints
// (tai/Runtime/Threads/Safepoint.h); at the first of them signals are handled
// and the lock is released, so that other threads run, and `afterCall` acquires
// it again. Short calls pay for neither.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PYTHON_SAFEPOINT_H
#define TAI_PYTHON_SAFEPOINT_H

#include <Python.h>
#include <atomic>

namespace taipy {

/// State that safepoints within a call keep for the end of the call.
struct CallState {
  /// The state of the Python thread, set if Python's lock has been released.
  PyThreadState *released = nullptr;
  /// True if a signal handler has raised an exception, which is the current
  /// Python error.
  bool isInterrupted = false;
  /// True if Python's lock has been released or a handler has raised an
  /// exception.
  bool isChanged = false;
  /// True if the call destroys an object, and must not raise an exception.
  bool isTeardown = false;
};

extern thread_local CallState callState
    __attribute__((tls_model("initial-exec")));

/// Set if warnings are pending, which `afterCall` must issue.
extern std::atomic<bool> warningsWait;
/// Issues pending warnings; false if that has raised.
bool tellWarnings();

/// Acquires Python's lock again if a safepoint has released it.
void retakeLock();

/// Call after each call of libtai, before Python is used
/// (`scripts/lock_discipline.py` finds calls without it). False if a Python
/// exception has been raised meanwhile, which must be propagated, whether the
/// call failed or not.
inline bool afterCall() {
  if (__builtin_expect(!callState.isChanged &&
                           !warningsWait.load(std::memory_order_relaxed),
                       true))
    return true;
  retakeLock();
  bool isInterrupted = callState.isInterrupted;
  callState.isInterrupted = callState.isChanged = false;
  return !isInterrupted && tellWarnings();
}

/// Around a call of libtai that destroys the object behind a Python object. The
/// call may wait for another thread and release the lock meanwhile, but a
/// destructor cannot raise: signals stay pending, and a current exception and
/// the state of an enclosing call are preserved.
class Teardown {
public:
  Teardown();
  ~Teardown();
  Teardown(const Teardown &) = delete;
  Teardown &operator=(const Teardown &) = delete;

private:
  CallState outer;
  /// False if the interpreter has ended or the thread does not hold its lock.
  bool hasLock;
  /// The exception; its type and trace before Python 3.12.
  PyObject *error = nullptr, *type = nullptr, *trace = nullptr;
};

/// PyErr_Clear(), except that an exception of a signal handler is not lost but
/// raised again later. For optional queries of Python objects.
void forgetError();

void bindSafepoints();

} // namespace taipy

#endif // TAI_PYTHON_SAFEPOINT_H
