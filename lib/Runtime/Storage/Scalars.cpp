//===- Scalars.cpp - Conversions of scalars -------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The conversions to the 16-bit types are written out: going through f32 would
// round twice, and not every C++ runtime library has the direct ones.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Storage/Scalars.h"
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

using namespace mlir::tai::runtime;

int64_t mlir::tai::runtime::byteSize(ScalarKind kind) {
  switch (kind) {
  case ScalarKind::I1:
  case ScalarKind::I8:
    return 1;
  case ScalarKind::I16:
  case ScalarKind::F16:
  case ScalarKind::BF16:
    return 2;
  case ScalarKind::I32:
  case ScalarKind::F32:
    return 4;
  case ScalarKind::I64:
  case ScalarKind::F64:
    return 8;
  }
  return 0;
}

bool mlir::tai::runtime::isFloat(ScalarKind kind) {
  return kind == ScalarKind::F16 || kind == ScalarKind::BF16 ||
         kind == ScalarKind::F32 || kind == ScalarKind::F64;
}

const char *mlir::tai::runtime::spelling(ScalarKind kind) {
  const char *names[] = {"i8",   "i16", "i32", "i64", "f16",
                         "bf16", "f32", "f64", "i1"};
  return names[static_cast<int>(kind)];
}

static uint16_t encode(double value, int exponentBits, int mantissaBits) {
  int bias = (1 << (exponentBits - 1)) - 1;
  uint32_t infinity = ((1u << exponentBits) - 1) << mantissaBits;
  uint32_t sign = std::signbit(value) ? 0x8000u : 0;
  double magnitude = std::fabs(value);
  if (std::isnan(value))
    return static_cast<uint16_t>(sign | infinity | (1u << (mantissaBits - 1)));
  if (std::isinf(value))
    return static_cast<uint16_t>(sign | infinity);
  if (magnitude == 0)
    return static_cast<uint16_t>(sign);
  int exponent;
  std::frexp(magnitude, &exponent);
  exponent = std::max(exponent - 1, 1 - bias);
  // The quotient of the magnitude and the value of the last place is exact, so
  // the number is rounded once.
  double units = std::nearbyint(std::ldexp(magnitude, mantissaBits - exponent));
  if (exponent > bias)
    return static_cast<uint16_t>(sign | infinity);
  // A mantissa that rounds up to the next power of two carries into the
  // exponent by itself.
  uint32_t bits = (static_cast<uint32_t>(exponent + bias - 1) << mantissaBits) +
                  static_cast<uint32_t>(units);
  return static_cast<uint16_t>(sign | std::min(bits, infinity));
}

static double decode(uint16_t bits, int exponentBits, int mantissaBits) {
  int bias = (1 << (exponentBits - 1)) - 1;
  int exponent = (bits & 0x7fff) >> mantissaBits;
  int mantissa = bits & ((1 << mantissaBits) - 1);
  double magnitude;
  if (exponent == (1 << exponentBits) - 1)
    magnitude = mantissa ? std::numeric_limits<double>::quiet_NaN()
                         : std::numeric_limits<double>::infinity();
  else if (exponent == 0)
    magnitude = std::ldexp(mantissa, 1 - bias - mantissaBits);
  else
    magnitude = std::ldexp(mantissa + (1 << mantissaBits),
                           exponent - bias - mantissaBits);
  return bits & 0x8000 ? -magnitude : magnitude;
}

uint16_t mlir::tai::runtime::halfFromDouble(double value) {
  return encode(value, 5, 10);
}
uint16_t mlir::tai::runtime::bfloatFromDouble(double value) {
  return encode(value, 8, 7);
}
double mlir::tai::runtime::doubleFromHalf(uint16_t bits) {
  return decode(bits, 5, 10);
}
double mlir::tai::runtime::doubleFromBfloat(uint16_t bits) {
  return decode(bits, 8, 7);
}

/// Converts to an integer by truncation; NaN becomes 0, and a value out of
/// range the nearest limit.
static int64_t toInteger(double value) {
  if (std::isnan(value))
    return 0;
  if (value >= 9223372036854775808.0)
    return std::numeric_limits<int64_t>::max();
  if (value < -9223372036854775808.0)
    return std::numeric_limits<int64_t>::min();
  return static_cast<int64_t>(value);
}

template <typename T> static T load(const char *address) {
  T value;
  std::memcpy(&value, address, sizeof(T));
  return value;
}
template <typename T> static void store(char *address, T value) {
  std::memcpy(address, &value, sizeof(T));
}

double mlir::tai::runtime::loadF64(ScalarKind kind, const char *address) {
  switch (kind) {
  case ScalarKind::F16:
    return doubleFromHalf(load<uint16_t>(address));
  case ScalarKind::BF16:
    return doubleFromBfloat(load<uint16_t>(address));
  case ScalarKind::F32:
    return load<float>(address);
  case ScalarKind::F64:
    return load<double>(address);
  default:
    return static_cast<double>(loadI64(kind, address));
  }
}

int64_t mlir::tai::runtime::loadI64(ScalarKind kind, const char *address) {
  switch (kind) {
  case ScalarKind::I1:
    return load<uint8_t>(address) != 0;
  case ScalarKind::I8:
    return load<int8_t>(address);
  case ScalarKind::I16:
    return load<int16_t>(address);
  case ScalarKind::I32:
    return load<int32_t>(address);
  case ScalarKind::I64:
    return load<int64_t>(address);
  default:
    return toInteger(loadF64(kind, address));
  }
}

void mlir::tai::runtime::storeF64(ScalarKind kind, char *address,
                                  double value) {
  switch (kind) {
  case ScalarKind::F16:
    return store(address, halfFromDouble(value));
  case ScalarKind::BF16:
    return store(address, bfloatFromDouble(value));
  case ScalarKind::F32:
    return store(address, static_cast<float>(value));
  case ScalarKind::F64:
    return store(address, value);
  case ScalarKind::I1:
    return store(address, static_cast<uint8_t>(value != 0));
  default:
    return storeI64(kind, address, toInteger(value));
  }
}

void mlir::tai::runtime::storeI64(ScalarKind kind, char *address,
                                  int64_t value) {
  switch (kind) {
  case ScalarKind::I1:
    return store(address, static_cast<uint8_t>(value != 0));
  case ScalarKind::I8:
    return store(address, static_cast<int8_t>(value));
  case ScalarKind::I16:
    return store(address, static_cast<int16_t>(value));
  case ScalarKind::I32:
    return store(address, static_cast<int32_t>(value));
  case ScalarKind::I64:
    return store(address, value);
  default:
    return storeF64(kind, address, static_cast<double>(value));
  }
}
