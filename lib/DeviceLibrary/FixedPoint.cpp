//===- FixedPoint.cpp - Sums that do not depend on their order ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Integers that are added by atomics have the same sum in any order. The unit
// of an element's sum follows from the largest exponent of its terms: it is
// 2^-30 for f32, or 2^-60 for f64 (in two integers of 30 bits each), of the
// power of two above the largest term. Each integer has 64 bits, so that 2^33
// terms cannot overflow it.
//
// If all lanes of a warp add to one element, they combine their terms first:
// atomic operations on one address run one after another.
//
//===----------------------------------------------------------------------===//

#include "Warp.h"
#include "tai/ABI/DeviceAbi.h"

using namespace tai::device;

namespace {
template <typename T> struct Format;
template <> struct Format<float> {
  using Bits = uint32_t;
  static constexpr unsigned fraction = 23, bias = 127, window = 30;
};
template <> struct Format<double> {
  using Bits = uint64_t;
  static constexpr unsigned fraction = 52, bias = 1023, window = 60;
};

/// The parts of a float: |value| = significand * 2^(exponent - bias -
/// fraction).
template <typename T> struct Parts {
  using Bits = typename Format<T>::Bits;
  static constexpr unsigned fraction = Format<T>::fraction;
  static constexpr uint32_t special = 2 * Format<T>::bias + 1;

  explicit Parts(T value) {
    auto bits = __builtin_bit_cast(Bits, value);
    significand = bits & ((Bits(1) << fraction) - 1);
    exponent = static_cast<uint32_t>(bits >> fraction) & special;
    isNegative = bits >> (sizeof(Bits) * 8 - 1) != 0;
    if (exponent == 0)
      exponent = 1;
    else
      significand |= Bits(1) << fraction;
  }

  Bits significand;
  uint32_t exponent;
  bool isNegative;
};
} // namespace

// If an element has infinite or NaN terms, its sum is a set of these bits
// instead of a number.
static constexpr uint64_t hasInfinity = 1, hasNegative = 2, hasNaN = 4;

static constexpr unsigned limbBits = 30;

//===----------------------------------------------------------------------===//
// Scales
//===----------------------------------------------------------------------===//

template <typename T> static void noteScale(uint32_t *scale, T value) {
  Parts<T> parts(value);
  uint32_t exponent = parts.significand != 0 ? parts.exponent : 0;
  if (isSameInWarp(reinterpret_cast<uint64_t>(scale))) {
    exponent = combineInWarp(
        exponent, [](uint32_t a, uint32_t b) { return a < b ? b : a; });
    if (getLane() != 0)
      return;
  }
  // This load possibly misses the store of another thread; then an unnecessary
  // atomic maximum follows.
  if (*scale < exponent)
    atomicMax(scale, exponent);
}

//===----------------------------------------------------------------------===//
// Sums
//===----------------------------------------------------------------------===//

/// The magnitude of a float as an integer, in units that follow from `scale`,
/// rounded to nearest.
template <typename T>
static uint64_t toUnits(const Parts<T> &parts, uint32_t scale) {
  constexpr unsigned room = Format<T>::window - Format<T>::fraction - 1;
  uint32_t below = scale - parts.exponent;
  uint64_t units = uint64_t(parts.significand) << room;
  if (below <= room)
    return units >> below;
  if (below >= 64)
    return 0;
  return (units + (uint64_t(1) << (below - 1))) >> below;
}

static void addInteger(uint64_t *sum, uint64_t units, bool isNegative,
                       bool isTogether) {
  if (isNegative)
    units = -units;
  if (isTogether) {
    units = combineInWarp(units, [](uint64_t a, uint64_t b) { return a + b; });
    if (getLane() != 0)
      return;
  }
  if (units != 0)
    atomicAdd(sum, units);
}

static void addUnits(uint64_t *sum, uint64_t units, bool isNegative,
                     bool isTogether, float) {
  addInteger(sum, units, isNegative, isTogether);
}

static void addUnits(uint64_t *sum, uint64_t units, bool isNegative,
                     bool isTogether, double) {
  addInteger(sum, units >> limbBits, isNegative, isTogether);
  addInteger(sum + 1, units & ((uint64_t(1) << limbBits) - 1), isNegative,
             isTogether);
}

template <typename T>
static void addValue(const uint32_t *scale, uint64_t *sum, T value) {
  Parts<T> parts(value);
  bool isTogether = isSameInWarp(reinterpret_cast<uint64_t>(scale));
  if (parts.significand == 0 && !isTogether)
    return;
  // If only zeros are added to an element, its scale is not set.
  uint32_t exponent = *scale;
  if (exponent != Parts<T>::special) {
    uint64_t units = parts.significand != 0 ? toUnits(parts, exponent) : 0;
    return addUnits(sum, units, parts.isNegative, isTogether, value);
  }
  if (parts.exponent == exponent)
    atomicOr(sum, value != value     ? hasNaN
                  : parts.isNegative ? hasNegative
                                     : hasInfinity);
}

//===----------------------------------------------------------------------===//
// Results
//===----------------------------------------------------------------------===//

/// 2^exponent for normal numbers.
static double powerOfTwo(int exponent) {
  return __builtin_bit_cast(double, uint64_t(exponent + 1023) << 52);
}

static double getSpecial(uint64_t bits) {
  if (bits & hasNaN || bits == (hasInfinity | hasNegative))
    return __builtin_nan("");
  return bits & hasNegative ? -__builtin_inf() : __builtin_inf();
}

static double getSum(uint64_t units, uint32_t scale) {
  constexpr int unit = int(Format<float>::bias) - 1 + Format<float>::window;
  if (scale == Parts<float>::special)
    return getSpecial(units);
  return static_cast<double>(static_cast<int64_t>(units)) *
         powerOfTwo(static_cast<int>(scale) - unit);
}

static void round(uint64_t *sum, uint32_t scale, float *element) {
  if (*sum != 0)
    *element = static_cast<float>(double(*element) + getSum(*sum, scale));
}

/// Combines the two integers to one of 128 bits, and rounds it once, unless the
/// result is subnormal.
static void round(uint64_t *sum, uint32_t scale, double *element) {
  constexpr int unit = int(Format<double>::bias) - 1 + Format<double>::window;
  if (scale == Parts<double>::special) {
    *element += getSpecial(sum[0]);
    return;
  }
  auto high = static_cast<int64_t>(sum[0]), low = static_cast<int64_t>(sum[1]);
  uint64_t lower = uint64_t(high) << limbBits;
  auto upper = static_cast<uint64_t>(high >> (64 - limbBits));
  upper += static_cast<uint64_t>(low >> 63);
  lower += static_cast<uint64_t>(low);
  upper += lower < static_cast<uint64_t>(low) ? 1 : 0;
  bool isNegative = upper >> 63 != 0;
  if (isNegative) {
    lower = ~lower + 1;
    upper = ~upper + (lower == 0 ? 1 : 0);
  }
  if ((upper | lower) == 0)
    return;
  int exponent = static_cast<int>(scale) - unit;
  if (upper != 0) {
    // The lowest bit is set if bits were cut off, because they decide ties in
    // rounding.
    int shift = 64 - __builtin_clzll(upper);
    uint64_t rest = shift < 64 ? lower << (64 - shift) : lower;
    lower = (shift < 64 ? lower >> shift : 0) |
            (shift < 64 ? upper << (64 - shift) : upper);
    lower |= rest != 0 ? 1 : 0;
    exponent += shift;
  }
  int half = exponent / 2;
  double total = static_cast<double>(lower) * powerOfTwo(half) *
                 powerOfTwo(exponent - half);
  *element += isNegative ? -total : total;
}

template <typename T>
static void addSum(uint32_t *scale, uint64_t *sum, T *element) {
  if (atomicRead(scale) == 0)
    return;
  if (uint32_t exponent = atomicExchange(scale, uint32_t(0)))
    round(sum, exponent, element);
}

#define TAI_FIXED(type, suffix)                                                \
  void tai_dev_fixed_scale_##suffix(uint32_t *scale, type value) {             \
    noteScale(scale, value);                                                   \
  }                                                                            \
  void tai_dev_fixed_add_##suffix(const uint32_t *scale, uint64_t *sum,        \
                                  type value) {                                \
    addValue(scale, sum, value);                                               \
  }                                                                            \
  void tai_dev_fixed_round_##suffix(uint32_t *scale, uint64_t *sum,            \
                                    type *element) {                           \
    addSum(scale, sum, element);                                               \
  }
TAI_FIXED(float, f32)
TAI_FIXED(double, f64)
#undef TAI_FIXED

double tai_dev_fixed_take_f32(uint32_t *scale, uint64_t *sum) {
  uint32_t exponent = atomicExchange(scale, uint32_t(0));
  return exponent && *sum != 0 ? getSum(*sum, exponent) : -0.0;
}
