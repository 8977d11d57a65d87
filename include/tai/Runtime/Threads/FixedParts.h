//===- FixedParts.h - Thread-independent partitions -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_THREADS_FIXEDPARTS_H
#define TAI_RUNTIME_THREADS_FIXEDPARTS_H

#include <algorithm>
#include <cstdint>

namespace mlir::tai::runtime {

/// The number of parts into which a reduction over `n` iterations is divided,
/// each iteration taking `cost` nanoseconds by the compiler's estimate. Depends
/// on the loop alone, not on the number of threads. Parts are few, because each
/// needs a private copy of the reduced values.
inline int64_t fixedParts(int64_t n, double cost) {
  constexpr int64_t partNs = 16000, mostParts = 32;
  double exact = static_cast<double>(n) * std::max(cost, 1e-3);
  int64_t total = exact < 9e18 ? static_cast<int64_t>(exact) : INT64_MAX;
  return std::min(n, std::clamp<int64_t>(total / partNs, 1, mostParts));
}

/// The first iteration of part number `part`, if `n` iterations are divided
/// into `parts` parts: n * part / parts, without overflow.
inline int64_t boundOf(int64_t n, int64_t part, int64_t parts) {
  return n / parts * part + n % parts * part / parts;
}

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_THREADS_FIXEDPARTS_H
