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
  /// A store overwrites an element that was read; the derivative of the read
  /// needs the overwritten value.
  OverwrittenAfterRead,
  /// An atomic update changes an element that was read.
  AccumulatedAfterRead,
  /// An element is stored a second time, or stored after an accumulation into
  /// it.
  WrittenTwice,
  /// Two iterations of one parallel loop store to the same element.
  Race,
  /// An iteration reads an element that another iteration of the same parallel
  /// loop writes.
  EarlyRead,
};

} // namespace mlir::tai::runtime::accesslog

#endif // TAI_ABI_ACCESSLOG_H
