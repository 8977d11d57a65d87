//===- Launcher.h - Launches on behalf of other parts -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PYTHON_LAUNCHER_H
#define TAI_PYTHON_LAUNCHER_H

#include "ArrayArguments.h"
#include "Safepoint.h"

namespace taipy {

/// Launches with gradients that are passed beside the tensors. `No` if no code
/// for these arguments has been compiled; `Error`, with a Python error, on
/// failure.
Match launchBeside(PyObject *launcher, PyObject *const *args,
                   const Beside *gradients, size_t count);

/// Runs the body of a function that Python calls, and turns C++ exceptions,
/// which must not reach Python, into Python errors.
template <typename Body> PyObject *runForPython(Body body) noexcept {
  try {
    return body();
  } catch (py::error_already_set &error) {
    error.restore();
  } catch (...) {
    // A call of libtai may have released the lock of Python.
    if (afterCall())
      PyErr_NoMemory();
  }
  return nullptr;
}

} // namespace taipy

#endif // TAI_PYTHON_LAUNCHER_H
