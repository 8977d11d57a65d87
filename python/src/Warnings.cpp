//===- Warnings.cpp - Warnings of the compiler in Python ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Warnings.h"
#include "Safepoint.h"

#include <mutex>
#include <string>
#include <vector>

using namespace taipy;

std::atomic<bool> taipy::warningsWait{false};

namespace {
struct KeptWarning {
  std::string message, file;
  int line, column;
  std::string diagnostics;
  bool ofGradient;
};

std::mutex mutex;
std::vector<KeptWarning> kept;
} // namespace

void taipy::keepWarning(const TaiWarning *warning, void *) {
  std::lock_guard<std::mutex> lock(mutex);
  kept.push_back({warning->message, warning->file, warning->line,
                  warning->column, warning->diagnostics, warning->of_gradient});
  warningsWait.store(true, std::memory_order_relaxed);
}

bool taipy::tellWarnings() {
  if (!warningsWait.load(std::memory_order_relaxed))
    return true;
  // A warning must not replace a current exception.
  if (!PyGILState_Check() || PyErr_Occurred())
    return true;
  std::vector<KeptWarning> told;
  {
    std::lock_guard<std::mutex> lock(mutex);
    told.swap(kept);
    warningsWait.store(false, std::memory_order_relaxed);
  }
  PyObject *errors = PyImport_ImportModule("tai.errors");
  bool isGood = errors != nullptr;
  for (const KeptWarning &warning : told) {
    if (!isGood)
      break;
    PyObject *result = PyObject_CallMethod(
        errors, "warn_from_core", "ssiisO", warning.message.c_str(),
        warning.file.c_str(), warning.line, warning.column,
        warning.diagnostics.c_str(), warning.ofGradient ? Py_True : Py_False);
    isGood = result != nullptr;
    Py_XDECREF(result);
  }
  Py_XDECREF(errors);
  return isGood;
}
