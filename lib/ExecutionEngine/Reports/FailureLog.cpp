//===- FailureLog.cpp - Failures of a session -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Reports/FailureLog.h"
#include "llvm/Support/FormatVariadic.h"

using namespace mlir;
using namespace mlir::tai;

/// The last failure of each thread, and the log (of a session) that it belongs
/// to.
static thread_local Failure lastFailure;
static thread_local const FailureLog *lastLog = nullptr;

LogicalResult FailureLog::fail(Failure failure) {
  lastFailure = std::move(failure);
  lastLog = this;
  return mlir::failure();
}

const Failure &FailureLog::getLast() const {
  static const Failure none;
  return lastLog == this ? lastFailure : none;
}

runtime::Status FailureLog::keep(Failure failure) {
  std::lock_guard<std::mutex> lock(mutex);
  std::string where;
  if (!failure.file.empty())
    where = llvm::formatv("{0}:{1}:{2}", failure.file, failure.line,
                          failure.column);
  auto status = runtime::Status::failure(
      runtime::StatusCode::Compile, failure.message, where,
      static_cast<int>(numDropped + kept.size()) + 1);
  kept.push_back(std::move(failure));
  // The number of failures that are kept; older ones are reported by their
  // status alone.
  constexpr size_t mostFailures = 1024;
  if (kept.size() > mostFailures) {
    kept.pop_front();
    ++numDropped;
  }
  return status;
}

int64_t FailureLog::numKept() const {
  std::lock_guard<std::mutex> lock(mutex);
  return static_cast<int64_t>(kept.size());
}

static FailureKind getKind(runtime::StatusCode code) {
  switch (code) {
  case runtime::StatusCode::Memory:
    return FailureKind::Memory;
  case runtime::StatusCode::Usage:
    return FailureKind::Usage;
  case runtime::StatusCode::Compile:
  case runtime::StatusCode::Internal:
    return FailureKind::Internal;
  default:
    return FailureKind::Runtime;
  }
}

LogicalResult FailureLog::fail(const runtime::Status &status) {
  size_t number = status.detail();
  if (status.code() == runtime::StatusCode::Compile && number > 0) {
    std::lock_guard<std::mutex> lock(mutex);
    if (number > numDropped && number - numDropped <= kept.size())
      return fail(kept[number - numDropped - 1]);
  }
  Failure failure = Failure::get(getKind(status.code()), status.message());
  // The place has the form "file:line:col", where the file name may contain
  // colons.
  StringRef place = status.where();
  auto [head, column] = place.rsplit(':');
  auto [file, line] = head.rsplit(':');
  if (!line.getAsInteger(10, failure.line) &&
      !column.getAsInteger(10, failure.column)) {
    failure.file = file.str();
    failure.text = formatDiagnostic(failure.file, failure.line, failure.column,
                                    "error", failure.message);
  }
  return fail(std::move(failure));
}
