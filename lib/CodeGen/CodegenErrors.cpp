//===- CodegenErrors.cpp - Errors inside LLVM -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "CodegenErrors.h"
#include "tai/CodeGen/InjectedFailures.h"
#include "llvm/IR/DiagnosticInfo.h"
#include "llvm/IR/DiagnosticPrinter.h"
#include "llvm/Support/ErrorHandling.h"
#include "llvm/Support/raw_ostream.h"
#include <csetjmp>
#include <mutex>

using namespace llvm;
using namespace mlir::tai;

namespace {
/// The target of the long jump for a fatal error of LLVM, on a thread that runs
/// LLVM.
struct FatalTarget {
  std::jmp_buf place;
  std::string message;
};
} // namespace

static thread_local FatalTarget *fatalTarget = nullptr;

static void onFatalError(void *, const char *message, bool) {
  if (fatalTarget) {
    fatalTarget->message = message;
    std::longjmp(fatalTarget->place, 1);
  }
  // The error is on a thread outside guardFatalErrors: act like LLVM does
  // without a handler.
  errs() << "LLVM ERROR: " << message << '\n';
}

/// Leaves `task` by a long jump, as LLVM's own crash recovery does, but does
/// not change the process's signal handlers.
Error mlir::tai::guardFatalErrors(bool &broken, StringRef place,
                                  function_ref<void()> task) {
  static std::mutex mutex;
  static unsigned users = 0;
  auto count = [](int change) {
    std::lock_guard<std::mutex> lock(mutex);
    if (users == 0)
      install_fatal_error_handler(onFatalError);
    users += change;
    if (users == 0)
      remove_fatal_error_handler();
  };
  FatalTarget target;
  count(1);
  if (setjmp(target.place) == 0) {
    fatalTarget = &target;
    if (injectsFailure(place))
      report_fatal_error("a failure was asked for", /*gen_crash_diag=*/false);
    task();
  } else {
    broken = true;
  }
  fatalTarget = nullptr;
  count(-1);
  if (broken)
    return createStringError(target.message);
  return Error::success();
}

bool CodegenErrors::handleDiagnostics(const DiagnosticInfo &info) {
  if (info.getSeverity() == DS_Error && message.empty()) {
    raw_string_ostream stream(message);
    DiagnosticPrinterRawOStream printer(stream);
    info.print(printer);
  }
  return true;
}
