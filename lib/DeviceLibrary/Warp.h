//===- Warp.h - Exchange among lanes of a warp ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_DEVICELIBRARY_WARP_H
#define TAI_LIB_DEVICELIBRARY_WARP_H

#include "Target.h"

namespace tai::device {

/// The value that lane `from` passes. All lanes of the warp must call this
/// function together.
inline uint32_t exchange(uint32_t value, unsigned from) {
  return shuffle(wholeWarp, value, from);
}

inline uint64_t exchange(uint64_t value, unsigned from) {
  uint64_t low = exchange(static_cast<uint32_t>(value), from);
  uint64_t high = exchange(static_cast<uint32_t>(value >> 32), from);
  return high << 32 | low;
}

inline float exchange(float value, unsigned from) {
  return __builtin_bit_cast(
      float, exchange(__builtin_bit_cast(uint32_t, value), from));
}

inline double exchange(double value, unsigned from) {
  return __builtin_bit_cast(
      double, exchange(__builtin_bit_cast(uint64_t, value), from));
}

/// Combines the values of all lanes of a warp; each lane gets the result. All
/// lanes must call together.
template <typename T, typename Combine>
inline T combineInWarp(T value, Combine combine) {
#pragma unroll
  for (unsigned offset = warpSize / 2; offset; offset /= 2)
    value = combine(value, exchange(value, getLane() ^ offset));
  return value;
}

} // namespace tai::device

#endif // TAI_LIB_DEVICELIBRARY_WARP_H
