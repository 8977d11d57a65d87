//===- WithBlock.cpp - `with` blocks that are always left -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `WithBlock` is the base class of objects that stand in a `with` statement and
// change the state of the package. Python calls signal handlers between its
// steps: an exception of a handler may come before the first line of an
// `__exit__` written in Python, or between two lines of a `finally`. These
// methods are therefore written in C++. They call
//
// - `_enter()`, which returns the target of `as`; by default, the object.
// - `_leave(kind, error, trace)` at the end of the block; by default, nothing.
// - `_end()`, which undoes what `_enter` and the block have done.
//
// `_end` is called at the end in any case, also if `_enter` or `_leave` raises,
// and called again if it raises itself. It must do nothing where there is
// nothing left to undo. Objects with an attribute `_lock` hold that lock
// meanwhile.
//
//===----------------------------------------------------------------------===//

#include "Core.h"

#include <utility>

using namespace taipy;

namespace {

struct WithBlock {
  PyObject_HEAD PyObject *lock;
  bool isOpen;
};

/// Saves the Python exception that is being raised and restores it later, so
/// that other Python code can run meanwhile.
class Raised {
public:
  Raised() { take(); }
  ~Raised() {
    Py_XDECREF(type);
    Py_XDECREF(error);
    Py_XDECREF(trace);
  }
  Raised(const Raised &) = delete;
  Raised &operator=(const Raised &) = delete;

  explicit operator bool() const { return type != nullptr; }
  /// Saves the current exception; if there is one already, the new one is
  /// dropped.
  void take() {
    if (type)
      PyErr_Clear();
    else
      PyErr_Fetch(&type, &error, &trace);
  }
  void raise() {
    PyErr_Restore(type, error, trace);
    type = error = trace = nullptr;
  }

private:
  PyObject *type = nullptr, *error = nullptr, *trace = nullptr;
};

bool callMethod(PyObject *object, const char *name) {
  PyObject *answer = PyObject_CallMethod(object, name, nullptr);
  Py_XDECREF(answer);
  return answer != nullptr;
}

/// Calls `_end` until it returns without an exception. Exceptions of `_end` are
/// raised unless another exception is being raised.
void end(PyObject *object) {
  Raised raised;
  // Repeated Ctrl-C may interrupt `_end` several times.
  constexpr int mostTries = 8;
  for (int i = 0; i < mostTries && !callMethod(object, "_end"); ++i)
    raised.take();
  auto *self = reinterpret_cast<WithBlock *>(object);
  self->isOpen = false;
  if (PyObject *lock = std::exchange(self->lock, nullptr)) {
    if (!callMethod(lock, "release"))
      raised.take();
    Py_DECREF(lock);
  }
  if (raised)
    raised.raise();
}

PyObject *enter(PyObject *object, PyObject *) {
  auto *self = reinterpret_cast<WithBlock *>(object);
  PyObject *lock = PyObject_GetAttrString(object, "_lock");
  if (!lock)
    PyErr_Clear();
  if (lock && !self->lock) {
    if (!callMethod(lock, "acquire")) {
      Py_DECREF(lock);
      return nullptr;
    }
    self->lock = lock;
  } else {
    Py_XDECREF(lock);
  }
  // If an object whose block is open refuses a second block, the first one
  // stays open.
  bool wasOpen = std::exchange(self->isOpen, true);
  PyObject *answer = PyObject_CallMethod(object, "_enter", nullptr);
  if (!answer && !wasOpen)
    end(object);
  return answer;
}

PyObject *leave(PyObject *object, PyObject *args) {
  PyObject *method = PyObject_GetAttrString(object, "_leave");
  PyObject *answer = method ? PyObject_CallObject(method, args) : nullptr;
  Py_XDECREF(method);
  Py_XDECREF(answer);
  end(object);
  if (PyErr_Occurred())
    return nullptr;
  Py_RETURN_NONE;
}

void dealloc(PyObject *object) {
  Py_XDECREF(reinterpret_cast<WithBlock *>(object)->lock);
  PyTypeObject *type = Py_TYPE(object);
  type->tp_free(object);
  Py_DECREF(type);
}

PyObject *giveSelf(PyObject *object, PyObject *) { return Py_NewRef(object); }

PyObject *doNothing(PyObject *, PyObject *) { Py_RETURN_NONE; }

PyMethodDef methods[] = {
    {"__enter__", enter, METH_NOARGS, "begins the block"},
    {"__exit__", leave, METH_VARARGS, "ends the block"},
    {"_enter", giveSelf, METH_NOARGS, "at the begin of the block"},
    {"_leave", doNothing, METH_VARARGS, "at the end of the block"},
    {nullptr, nullptr, 0, nullptr}};

PyType_Slot slots[] = {{Py_tp_methods, methods},
                       {Py_tp_dealloc, reinterpret_cast<void *>(dealloc)},
                       {0, nullptr}};

PyType_Spec spec = {"tai._core.WithBlock", sizeof(WithBlock), 0,
                    Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE, slots};

} // namespace

void taipy::bindWithBlock(py::module_ &module) {
  auto type = py::reinterpret_steal<py::object>(PyType_FromSpec(&spec));
  if (!type)
    throw py::error_already_set();
  module.attr("WithBlock") = type;
}
