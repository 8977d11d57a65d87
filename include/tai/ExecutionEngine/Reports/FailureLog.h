//===- FailureLog.h - Failures of a session ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The last failure of each thread, and failures of compilations that pass
// through the runtime. The runtime has no source locations: it passes on a
// status with a number, by which the log finds the failure again.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_REPORTS_FAILURELOG_H
#define TAI_EXECUTIONENGINE_REPORTS_FAILURELOG_H

#include "mlir/Support/LLVM.h"
#include "tai/CodeGen/Diagnostics.h"
#include "tai/Support/Status.h"
#include <deque>
#include <mutex>

namespace mlir::tai {

/// Thread-safe.
class FailureLog {
public:
  /// The last failure reported to the calling thread.
  const Failure &getLast() const;

  /// Sets the last failure of the calling thread; returns failure().
  LogicalResult fail(Failure failure);
  LogicalResult fail(FailureKind kind, const Twine &message) {
    return fail(Failure::get(kind, message));
  }
  /// Sets the last failure of the calling thread from a status of the runtime;
  /// returns failure().
  LogicalResult fail(const runtime::Status &status);
  LogicalResult check(const runtime::Status &status) {
    return status.ok() ? success() : fail(status);
  }

  /// Keeps a failure in the log and returns a status that refers to it by
  /// number.
  runtime::Status keep(Failure failure);
  /// The number of failures kept in the log.
  int64_t numKept() const;

private:
  /// The most recent failures, and the number of older failures that were
  /// dropped.
  std::deque<Failure> kept;
  size_t numDropped = 0;
  mutable std::mutex mutex;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_REPORTS_FAILURELOG_H
