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

/// Launches with gradients that lie beside the tensors, if code for such
/// arguments has been compiled. `No` if none has, and `Error` with a Python
/// error.
Match launchBeside(PyObject *launcher, PyObject *const *args,
                   const Beside *gradients, size_t count);

/// Runs the body of a function that Python calls, into which no exception of
/// C++ may go.
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
