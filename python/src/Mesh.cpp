//===- Mesh.cpp - Exchanges between processes in Python -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Calls a Python function for each exchange of a launch. The launch may have
// released Python's lock at a safepoint.
//
//===----------------------------------------------------------------------===//

#include "Mesh.h"
#include "Core.h"
#include "tai-c/Mesh.h"

using namespace taipy;

namespace {
/// The function that Python has set, or null. Never freed: a launch may use it
/// while the interpreter ends.
PyObject *callee = nullptr;
std::string message;

py::tuple toTuple(const int64_t *numbers, int64_t count) {
  py::tuple result(count);
  for (int64_t i = 0; i < count; ++i)
    result[i] = numbers[i];
  return result;
}

const char *exchange(const TaiExchange *told) {
  if (!Py_IsInitialized() || !callee)
    return "the interpreter of Python has ended";
  py::gil_scoped_acquire lock;
  try {
    py::handle function = callee;
    function(told->kind, told->field, told->kernel, told->where, told->element,
             told->digest, told->block, told->before, told->after,
             reinterpret_cast<uintptr_t>(told->address), told->rows,
             toTuple(told->extents, told->num_dims),
             toTuple(told->strides, told->num_dims), told->on_device != 0);
    return nullptr;
  } catch (py::error_already_set &error) {
    message = py::str(error.value());
    if (message.empty())
      message = error.what();
  } catch (const std::exception &error) {
    message = error.what();
  }
  return message.c_str();
}
} // namespace

void taipy::bindMesh(py::module_ &module) {
  module.def(
      "set_mesh",
      [](int64_t rank, int64_t ranks, py::object function) {
        taiSetMesh(rank, ranks, function.is_none() ? nullptr : &exchange);
        settle();
        Py_XDECREF(callee);
        callee = function.release().ptr();
      },
      "Makes the process a rank of a mesh; each exchange calls the function.");
  module.def("exchanges_left_out", &taiMeshExchangesLeftOut,
             "The number of exchanges that were left out.");
}
