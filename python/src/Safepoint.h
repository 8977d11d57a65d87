//===- Safepoint.h - Python's lock and signals in long calls ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A call of libtai begins with Python's lock (GIL) held, and most end within
// microseconds. One that lasts reaches safepoints (tai/Runtime/Safepoint.h);
// at the first of them signals are handled and the lock is given up, so that
// other threads run, and `afterCall` takes it back. Short calls pay for
// neither.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PYTHON_SAFEPOINT_H
#define TAI_PYTHON_SAFEPOINT_H

#include <Python.h>
#include <atomic>

namespace taipy {

/// What a safepoint has left to do for the call that passed it.
struct CallState {
  /// Set where the lock has been given up.
  PyThreadState *released = nullptr;
  /// A signal handler has raised: the exception is set.
  bool isInterrupted = false;
  /// Either of them.
  bool isChanged = false;
  /// The call ends an object: it raises nothing.
  bool isTeardown = false;
};

extern thread_local CallState callState
    __attribute__((tls_model("initial-exec")));

/// Set where something waits that `afterCall` is to tell Python.
extern std::atomic<bool> warningsWait;
/// Gives to Python what waits; false where that has raised.
bool tellWarnings();

/// Takes the lock back where a safepoint has given it up.
void retakeLock();

/// To be called after each call of libtai, before anything of Python is used:
/// `scripts/lock_discipline.py` looks for calls that are not followed by it.
/// False where a Python exception has come in the meantime: the call failed, or
/// what it did is kept, and the exception is to be passed on.
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

/// Around a call of libtai that ends what a Python object stood for. It may
/// wait for another thread's call and gives the lock up meanwhile, but a
/// destructor has no way to raise: signals stay for the interpreter, and an
/// exception that is on its way, or a call that this one runs within, is left
/// as it was.
class Teardown {
public:
  Teardown();
  ~Teardown();
  Teardown(const Teardown &) = delete;
  Teardown &operator=(const Teardown &) = delete;

private:
  CallState outer;
  /// False where the interpreter has gone or the thread does not hold its lock.
  bool hasLock;
  PyObject *type = nullptr, *value = nullptr, *trace = nullptr;
};

/// For what Python was asked and need not answer: PyErr_Clear(), but a Ctrl-C
/// that came meanwhile is not lost, it comes again.
void forgetError();

void bindSafepoints();

} // namespace taipy

#endif // TAI_PYTHON_SAFEPOINT_H
