//===- WideF64.h - Functions of vectors of f64 ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Elementary functions of f64 for vectors of any length, within 0.7 units in
// the last place (0.8 if the result is denormal). As in WideFunctions.h, a
// result depends on the argument alone. Arguments are reduced to an f64 and its
// rounding error, so that hardly any rounding but the last one matters.
//
// Included by sources that are compiled for one kind of processor each, as
// WideFunctions.h is.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_MATH_WIDEF64_H
#define TAI_LIB_RUNTIME_MATH_WIDEF64_H

#include "WideFunctions.h"

extern "C" {
double sin(double);
double cos(double);
}

namespace {
template <int lanes> struct WideF64 : WideLanes<lanes> {
  using Base = WideLanes<lanes>;
  using Base::all;
  using Base::bits;
  using Base::fma;
  using Base::number;
  using Base::polynomial;
  using typename Base::F64;
  using typename Base::I64;

  /// An angle between -pi/4 and pi/4, r + rest, and the number of quarter turns
  /// that were taken from it, in the low bits.
  struct Angle {
    F64 r, rest;
    I64 quarters;
  };

  TAI_WIDE_INLINE F64 quartersIn(F64 x, I64 &quarters) {
    const F64 shifter = 0x1.8p52;
    F64 shifted = fma(x, F64(0x1.45f306dc9c883p-1), shifter);
    quarters = bits(shifted);
    return shifted - shifter;
  }

  /// Reduces a positive angle below 2^20.
  TAI_WIDE_INLINE Angle reduce(F64 x) {
    Angle angle;
    F64 k = quartersIn(x, angle.quarters);
    // pi / 2 in parts of 53, 33 and 53 bits. The first difference is exact. So
    // is the product with the second part, as k has 20 bits: r is rounded once,
    // and the error of that is exact.
    F64 first = fma(-k, F64(0x1.921fb54442d18p0), x);
    const F64 second = 0x1.1a626331p-54;
    angle.r = fma(-k, second, first);
    F64 error = fma(-k, second, first - angle.r);
    angle.rest = fma(-k, F64(0x1.1701b839a252p-88), error);
    return angle;
  }

  /// Reduces a positive angle below 2^40.
  TAI_WIDE_INLINE Angle reduceLarge(F64 x) {
    Angle angle;
    F64 k = quartersIn(x, angle.quarters);
    // pi / 2 in parts of 53 bits each. The first difference is exact. It is a
    // multiple of the last bit of `product`, so the error of the second one is
    // exact, too.
    F64 first = fma(-k, F64(0x1.921fb54442d18p0), x);
    const F64 second = 0x1.1a62633145c07p-54;
    F64 product = k * second;
    angle.r = first - product;
    F64 error = (first - angle.r) - product;
    error = error - fma(k, second, -product);
    angle.rest = fma(-k, F64(-0x1.f1976b7ed8fbcp-110), error);
    return angle;
  }

  /// Returns the sine of the angle; that of the angle and a quarter turn with
  /// `shift` = 1. `sign`: the sign bit to flip in the result.
  TAI_WIDE_INLINE F64 sine(const Angle &angle, long shift, I64 sign) {
    F64 r = angle.r, z = r * r;
    I64 turns = angle.quarters + shift;
    I64 isOdd = (turns << 63) != 0;
    // Even turns: sin(r) = r - r z / 8 + r z P(z). Odd turns:
    // cos(r) = 1 - r r / 2 + z z Q(z). The first difference is rounded, and its
    // error is exact but for that of z. P and Q leave an error of 2^-57 in the
    // result.
    F64 first = isOdd ? F64(1.) : r;
    F64 factor = r * (isOdd ? F64(-0.5) : F64(-0.125));
    F64 other = isOdd ? r : z;
    F64 head = fma(factor, other, first);
    F64 error = fma(factor, other, first - head);
    F64 p = polynomial(z, {-0x1.5555555555524p-5, 0x1.111111110f87ep-7,
                           -0x1.a01a019c0e238p-13, 0x1.71de35726bf82p-19,
                           -0x1.ae5e60c192267p-26, 0x1.5d911cf09c43p-33});
    F64 q = polynomial(z, {0x1.555555555554ap-5, -0x1.6c16c16c14ep-10,
                           0x1.a01a019c5c394p-16, -0x1.27e4f7cd31c51p-22,
                           0x1.1ee9c335b8673p-29, -0x1.8f99cbaf4f1dfp-37});
    F64 slope = isOdd ? -r : fma(z, F64(-0.5), F64(1.));
    F64 tail =
        fma((isOdd ? z : r) * z, isOdd ? q : p, fma(slope, angle.rest, error));
    F64 result = head + tail;
    return number(bits(result) ^ (((turns << 62) ^ sign) & (1L << 63)));
  }

  /// The sine where some angle is at least 2^20, infinite or NaN. `size`: the
  /// angle without its sign.
  __attribute__((noinline, cold)) static F64
  sineOfLarge(F64 x, F64 size, F64 result, long shift, I64 sign) {
    result = size < 0x1p20 ? result : sine(reduceLarge(size), shift, sign);
    if (!all(size < 0x1p40))
      for (int i = 0; i < lanes; ++i)
        if (!(size[i] < 0x1p40))
          result[i] = shift ? ::cos(x[i]) : ::sin(x[i]);
    return result;
  }

  TAI_WIDE_INLINE F64 sine(F64 x, long shift) {
    F64 size = __builtin_elementwise_abs(x);
    // The sine is odd, and the sign of zero stays.
    I64 sign = shift ? I64(0) : bits(x);
    F64 result = sine(reduce(size), shift, sign);
    if (__builtin_expect(!all(size < 0x1p20), false))
      return sineOfLarge(x, size, result, shift, sign);
    return result;
  }

  TAI_WIDE_INLINE F64 sin(F64 x) { return sine(x, 0); }
  TAI_WIDE_INLINE F64 cos(F64 x) { return sine(x, 1); }

  /// Returns e^x as a number between 0.7 and 1.42 times 2^`power`, for
  /// |x| < 2^10. `power`: in the low bits.
  TAI_WIDE_INLINE F64 exponential(F64 x, I64 &power) {
    const F64 shifter = 0x1.8p52;
    F64 shifted = fma(x, F64(0x1.71547652b82fep0), shifter);
    power = bits(shifted);
    F64 k = shifted - shifter;
    // The first difference is exact. `rest` is the rounding error of the second
    // one.
    F64 first = fma(-k, F64(0x1.62e42fefa39efp-1), x);
    const F64 second = 0x1.abc9e3b39803fp-56;
    F64 r = fma(-k, second, first);
    F64 rest = fma(-k, second, first - r);
    F64 p = polynomial(r, {0x1p-1, 0x1.55555555555p-3, 0x1.55555555531bfp-5,
                           0x1.1111111128cf6p-7, 0x1.6c16c17cdc187p-10,
                           0x1.a01a011add27bp-13, 0x1.a019aad84db8bp-16,
                           0x1.71df57789269cp-19, 0x1.289fe59458826p-22,
                           0x1.ad1daa4f28b5bp-26});
    F64 head = r + 1.;
    F64 error = r - (head - 1.);
    return head + fma(r * r, p, error + rest);
  }

  /// e^x where some result may be no normal number.
  __attribute__((noinline, cold)) static F64 exponentialOfLarge(F64 x) {
    // Beyond these bounds, the result is infinite or zero, too.
    x = x > 710. ? F64(710.) : x;
    x = x < -746. ? F64(-746.) : x;
    I64 power;
    F64 result = exponential(x, power);
    // The bits above those of the power go away in the shift.
    I64 bias = 1023, half = (power << 32) >> 33;
    result *= number((half + bias) << 52);
    // Products that round to zero take long.
    result = x < -745.5 ? F64(0.) : result;
    return result * number((power - half + bias) << 52);
  }

  TAI_WIDE_INLINE F64 exp(F64 x) {
    if (__builtin_expect(!all(__builtin_elementwise_abs(x) < 708.), false))
      return exponentialOfLarge(x);
    I64 power;
    F64 result = exponential(x, power);
    return number(bits(result) + (power << 52));
  }
};
} // namespace

/// Defines a function of one f64 for `lanes` numbers at once.
#define TAI_DEFINE_WIDE_F64(name, lanes)                                       \
  extern "C" WideF64<lanes>::F64 tai_wide_##name##_f64_##lanes(                \
      WideF64<lanes>::F64 x) {                                                 \
    return WideF64<lanes>::name(x);                                            \
  }

#endif // TAI_LIB_RUNTIME_MATH_WIDEF64_H
