//===- HalfCalls.cpp - Conversions of 16-bit floats for compiled code -----===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// LLVM calls these by the names of the compiler's own library where the
// processor has no instruction: f64 to f16 has none on x86, and bf16 has one on
// few. That library is not always in the process, so compiled code gets them
// from here.
//
//===----------------------------------------------------------------------===//

#include "../Storage/Scalars.h"
#include "tai/Runtime/Launch/Runtime.h"

#include <cstring>

using namespace mlir::tai::runtime;

/// 16-bit floats are passed as the compiler passes them: as floats.
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
}

void mlir::tai::runtime::appendHalfCalls(std::vector<RuntimeSymbol> &symbols) {
  auto add = [&](const char *name, auto *function) {
    symbols.push_back({name, reinterpret_cast<void *>(function)});
  };
  add("__truncdfhf2", truncateDoubleToHalf);
  add("__truncsfhf2", truncateFloatToHalf);
  add("__truncdfbf2", truncateDoubleToBfloat);
  add("__truncsfbf2", truncateFloatToBfloat);
  add("__extendhfsf2", extendHalfToFloat);
}
