//===- Core.h - Shared by the extension module ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The extension module `tai._core` uses tai-c and mlir-c alone, neither LLVM
// nor the C++ API of MLIR. It is compiled with exceptions, which never
// propagate through libtai.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PYTHON_CORE_H
#define TAI_PYTHON_CORE_H

#include "Safepoint.h"
#include "Warnings.h"
#include "tai-c/Tai.h"

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <map>
#include <memory>
#include <new>
#include <string>
#include <vector>

namespace taipy {

namespace py = pybind11;

/// Call after a function of libtai that cannot fail, but may have waited for
/// another thread. Throws if a signal handler has raised an exception
/// meanwhile.
inline void settle() {
  if (!afterCall())
    throw py::error_already_set();
}
/// Ends a call of libtai: handles what its safepoints have noted (see
/// settle()), and returns the result of the call.
template <typename Result> Result settled(Result result) {
  settle();
  return result;
}

/// A TaiContext with shared ownership: fields, kernels and tapes keep it alive.
struct Context {
  Context() : handle(taiContextCreate()) {
    if (!handle)
      throw std::bad_alloc();
    taiContextSetWarningHandler(handle, &keepWarning, nullptr);
  }
  ~Context() {
    Teardown teardown;
    taiContextDestroy(handle);
  }
  Context(const Context &) = delete;
  Context &operator=(const Context &) = delete;

  /// To be called with the status of each call of libtai, as soon as the call
  /// returns. Throws the Python exception for a failure.
  void check(TaiStatus status) const {
    if (!afterCall())
      throw py::error_already_set();
    if (status != TAI_OK)
      raise(status);
  }
  [[noreturn]] void raise(TaiStatus status) const;

  TaiContext handle;
};
using ContextRef = std::shared_ptr<Context>;

/// Sets the Python error for the last failure of `context` by way of
/// `tai.errors.from_core`, without throwing.
void setError(TaiContext context, TaiStatus status);

/// A kernel of the C API, which may not be compiled yet.
struct Kernel {
  Kernel(ContextRef context, TaiKernel handle)
      : context(std::move(context)), handle(handle) {}
  ~Kernel() {
    Teardown teardown;
    taiKernelDestroy(handle);
  }
  Kernel(const Kernel &) = delete;
  Kernel &operator=(const Kernel &) = delete;

  ContextRef context;
  TaiKernel handle;
};

/// A tape of the C API.
struct Tape {
  ContextRef context;
  TaiTape handle = nullptr;
  // Python objects that the records point to: callables and arrays.
  std::vector<std::unique_ptr<py::object>> kept;
  // The forward callables of host functions, by record, for reports.
  std::map<int64_t, py::object> hostFunctions;

  ~Tape() {
    Teardown teardown;
    if (handle)
      taiTapeDestroy(handle);
  }
};

void bindRuntime(py::module_ &module);
void bindBuilder(py::module_ &module);
void bindWithBlock(py::module_ &module);
void bindLauncher(py::module_ &module);
void bindOperatorCalls(py::module_ &module);
void bindInterop(py::module_ &module);
void bindXlaCalls(py::module_ &module);

} // namespace taipy

#endif // TAI_PYTHON_CORE_H
