//===- FailureLog.h - Failures of a session ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What went wrong last, for each thread, and failures of compilations on their
// way through the runtime, which knows nothing of places in a source: it passes
// a status with a number, and gets the failure back by it.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_FAILURELOG_H
#define TAI_EXECUTIONENGINE_FAILURELOG_H

#include "mlir/Support/LLVM.h"
#include "tai/CodeGen/Diagnostics.h"
#include "tai/Support/Status.h"
#include <deque>
#include <mutex>

namespace mlir::tai {

/// Any thread may call any of it.
class FailureLog {
public:
  /// The last failure of the calling thread.
  const Failure &getLast() const;

  /// Notes a failure of the calling thread; always fails.
  LogicalResult fail(Failure failure);
  LogicalResult fail(FailureKind kind, const Twine &message) {
    return fail(Failure::get(kind, message));
  }
  /// The same for a status of the runtime.
  LogicalResult fail(const runtime::Status &status);
  LogicalResult check(const runtime::Status &status) {
    return status.ok() ? success() : fail(status);
  }

  /// Keeps a failure and makes a status that stands for it.
  runtime::Status keep(Failure failure);
  /// Failures that statuses stand for.
  int64_t numKept() const;

private:
  /// The last ones, and how many there were before them.
  std::deque<Failure> kept;
  size_t numDropped = 0;
  mutable std::mutex mutex;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_FAILURELOG_H
