//===- LibraryCalls.cpp - Calls that LLVM makes by itself -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// LLVM calls these by the names of the compiler's own library where the
// processor has no instruction: f64 to f16 has none on x86, bf16 has one on
// few, and no processor divides 128 bits or has integer powers. That library is
// not always in the process, so compiled code gets them from here. The unit
// test `LibraryCalls` asks LLVM for all names that it may call.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/Runtime.h"
#include "tai/Runtime/Storage/Scalars.h"

#include <cmath>
#include <cstring>

using namespace mlir::tai::runtime;

/// Compilers pass _Float16 and __bf16 in floating-point registers, so the
/// functions below use these types instead of uint16_t.
template <typename T> static T fromBits(uint16_t bits) {
  T value;
  static_assert(sizeof(value) == sizeof(bits));
  std::memcpy(&value, &bits, sizeof(bits));
  return value;
}

extern "C" {
static _Float16 truncateDoubleToHalf(double value) {
  return fromBits<_Float16>(halfFromDouble(value));
}
static _Float16 truncateFloatToHalf(float value) {
  return fromBits<_Float16>(halfFromDouble(value));
}
static __bf16 truncateDoubleToBfloat(double value) {
  return fromBits<__bf16>(bfloatFromDouble(value));
}
static __bf16 truncateFloatToBfloat(float value) {
  return fromBits<__bf16>(bfloatFromDouble(value));
}
static float extendHalfToFloat(_Float16 value) {
  uint16_t bits;
  std::memcpy(&bits, &value, sizeof(bits));
  return static_cast<float>(doubleFromHalf(bits));
}

/// Fast math calls this function in place of pow for integral exponents. The
/// squares are formed in f64, so that their errors hardly reach the f32 result.
static float powerOfFloat(float base, int exponent) {
  double square = base, result = 1;
  for (unsigned left = std::abs(static_cast<int64_t>(exponent)); left;
       left >>= 1, square *= square)
    if (left & 1)
      result *= square;
  return static_cast<float>(exponent < 0 ? 1 / result : result);
}
static double powerOfDouble(double base, int exponent) {
  return std::pow(base, exponent);
}

__extension__ typedef __int128 Int128;
__extension__ typedef unsigned __int128 UnsignedWide;

static Int128 divideWide(Int128 a, Int128 b) { return a / b; }
static Int128 remainderWide(Int128 a, Int128 b) { return a % b; }
static UnsignedWide divideUnsignedWide(UnsignedWide a, UnsignedWide b) {
  return a / b;
}
static UnsignedWide remainderUnsignedWide(UnsignedWide a, UnsignedWide b) {
  return a % b;
}
static float floatFromWide(Int128 value) { return static_cast<float>(value); }
static double doubleFromWide(Int128 value) {
  return static_cast<double>(value);
}
static float floatFromUnsignedWide(UnsignedWide value) {
  return static_cast<float>(value);
}
static double doubleFromUnsignedWide(UnsignedWide value) {
  return static_cast<double>(value);
}
static Int128 wideFromFloat(float value) { return static_cast<Int128>(value); }
static Int128 wideFromDouble(double value) {
  return static_cast<Int128>(value);
}
static UnsignedWide unsignedWideFromFloat(float value) {
  return static_cast<UnsignedWide>(value);
}
static UnsignedWide unsignedWideFromDouble(double value) {
  return static_cast<UnsignedWide>(value);
}
}

void mlir::tai::runtime::appendLibraryCalls(
    std::vector<RuntimeSymbol> &symbols) {
  auto add = [&](const char *name, auto *function) {
    symbols.push_back({name, reinterpret_cast<void *>(function)});
  };
  add("__truncdfhf2", truncateDoubleToHalf);
  add("__truncsfhf2", truncateFloatToHalf);
  add("__truncdfbf2", truncateDoubleToBfloat);
  add("__truncsfbf2", truncateFloatToBfloat);
  add("__extendhfsf2", extendHalfToFloat);
  add("__powisf2", powerOfFloat);
  add("__powidf2", powerOfDouble);
  add("__divti3", divideWide);
  add("__modti3", remainderWide);
  add("__udivti3", divideUnsignedWide);
  add("__umodti3", remainderUnsignedWide);
  add("__floattisf", floatFromWide);
  add("__floattidf", doubleFromWide);
  add("__floatuntisf", floatFromUnsignedWide);
  add("__floatuntidf", doubleFromUnsignedWide);
  add("__fixsfti", wideFromFloat);
  add("__fixdfti", wideFromDouble);
  add("__fixunssfti", unsignedWideFromFloat);
  add("__fixunsdfti", unsignedWideFromDouble);
}
