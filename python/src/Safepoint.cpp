//===- Safepoint.cpp - Python's lock and signals in long calls ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Safepoint.h"
#include "tai-c/Tai.h"

using namespace taipy;

thread_local CallState taipy::callState;

namespace {
/// The number of Python's main thread, the only thread that handles signals.
unsigned long mainThread = 0;

/// After releasing the lock, the main thread acquires it for signals at only
/// one in this number of safepoints: it may have to wait for other threads.
constexpr unsigned kSafepointsBetweenSignals = 4;

/// Runs the handlers of pending signals; false if a handler has raised.
bool handleSignals() {
  if (PyErr_CheckSignals() == 0)
    return true;
  callState.isInterrupted = callState.isChanged = true;
  return false;
}

int atSafepoint() {
  CallState &state = callState;
  // A call that was interrupted does not go on.
  if (state.isInterrupted)
    return 0;
  if (!state.released) {
    // Nothing is done on threads without Python's lock and after failed
    // callbacks.
    if (!PyGILState_Check() || PyErr_Occurred())
      return 1;
    if (!state.isTeardown && !handleSignals())
      return 0;
  } else {
    static thread_local unsigned passed = 0;
    if (state.isTeardown || PyThread_get_thread_ident() != mainThread ||
        ++passed % kSafepointsBetweenSignals)
      return 1;
    retakeLock();
    if (!handleSignals())
      return 0;
  }
  state.isChanged = true;
  state.released = PyEval_SaveThread();
  return 1;
}
} // namespace

void taipy::retakeLock() {
  if (PyThreadState *released = callState.released) {
    callState.released = nullptr;
    PyEval_RestoreThread(released);
  }
}

Teardown::Teardown()
    : outer(callState), hasLock(Py_IsInitialized() && PyGILState_Check()) {
  if (!hasLock)
    return;
#if PY_VERSION_HEX < 0x030c0000
  PyErr_Fetch(&type, &error, &trace);
#else
  error = PyErr_GetRaisedException();
#endif
  callState = {};
  callState.isTeardown = true;
}

Teardown::~Teardown() {
  if (!hasLock)
    return;
  retakeLock();
  callState = outer;
#if PY_VERSION_HEX < 0x030c0000
  PyErr_Restore(type, error, trace);
#else
  PyErr_SetRaisedException(error);
#endif
}

namespace {
/// Raises a saved exception between two steps of the main thread.
int raiseAgain(void *error) {
  auto *object = static_cast<PyObject *>(error);
  PyErr_SetObject(reinterpret_cast<PyObject *>(Py_TYPE(object)), object);
  Py_DECREF(object);
  return -1;
}

/// True if a signal handler has raised the exception of a traceback.
bool isOfHandler(PyObject *trace) {
  // An exception that no Python code has raised has no traceback.
  if (!trace)
    return false;
  PyObject *module = PyImport_ImportModule("tai._impl.base.handlers");
  PyObject *answer = nullptr;
  if (module)
    answer = PyObject_CallMethod(module, "is_of_a_handler", "O", trace);
  bool isOfOne = answer == Py_True;
  Py_XDECREF(answer);
  Py_XDECREF(module);
  if (PyErr_Occurred() && PyErr_ExceptionMatches(PyExc_KeyboardInterrupt))
    PyErr_SetInterrupt();
  PyErr_Clear();
  return isOfOne;
}
} // namespace

void taipy::forgetError() {
  // Some callers have no error to forget; PyErr_ExceptionMatches requires one.
  if (!PyErr_Occurred())
    return;
  if (PyErr_ExceptionMatches(PyExc_KeyboardInterrupt)) {
    PyErr_Clear();
    PyErr_SetInterrupt();
    return;
  }
  PyObject *type, *error, *trace;
  PyErr_Fetch(&type, &error, &trace);
  PyErr_NormalizeException(&type, &error, &trace);
  if (isOfHandler(trace)) {
    PyException_SetTraceback(error, trace);
    if (Py_AddPendingCall(&raiseAgain, error) == 0)
      error = nullptr; // owned by the pending call
  }
  Py_XDECREF(type);
  Py_XDECREF(error);
  Py_XDECREF(trace);
}

void taipy::bindSafepoints() {
  // Any thread may import this module; the main thread is the oldest one.
  // Python code is not asked for it, since a signal handler might raise there.
  PyThreadState *oldest =
      PyInterpreterState_ThreadHead(PyInterpreterState_Main());
  while (PyThreadState *older = PyThreadState_Next(oldest))
    oldest = older;
  mainThread = oldest->thread_id;
  taiSetSafepointHandler(&atSafepoint);
}
