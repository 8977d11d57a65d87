//===- AccessLog.h - Shadow memory of checked kernels -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The layout of the arrays that a checked kernel (`tai-instrument-accesses`)
// has as additional arguments: a shadow array of 32-bit words for each field
// with an adjoint, a log of 64-bit words, and the number before the number of
// the launch's first access.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ABI_ACCESSLOG_H
#define TAI_ABI_ACCESSLOG_H

#include <cstdint>

namespace mlir::tai::runtime::accesslog {

/// The shadow words of each component of a field, initially zero. Accesses are
/// numbered from 1 over all launches; parallel loops are numbered from the same
/// start.
enum class ShadowWord : int64_t { Reader, Writer, Loop, Iteration };
constexpr int64_t kShadowWords = 4;

/// The log of each access of a launch: the number of violations, and (the other
/// access, component, kind) of the first violations.
constexpr int64_t kLogEntries = 4;
constexpr int64_t kLogWords = 1 + 3 * kLogEntries;

enum class ViolationKind : int64_t {
  /// A store to an element that was read; the derivative of the read needs the
  /// value.
  OverwrittenAfterRead,
  /// An accumulation into an element that was read.
  AccumulatedAfterRead,
  /// A second store, or a store to an element that was accumulated into.
  WrittenTwice,
  /// A second store by another iteration of the same loop.
  Race,
  /// A read of an element that another iteration of the same loop writes.
  EarlyRead,
};

} // namespace mlir::tai::runtime::accesslog

#endif // TAI_ABI_ACCESSLOG_H
