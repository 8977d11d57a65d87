//===- WideFunctions.h - Functions of vectors of f32, by f64 ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Elementary functions of f32 for vectors of any length, by short
// polynomials in f64: right to hardly more than half a unit in the last place.
// Each operation rounds as its scalar form does, so that a result depends on
// the argument alone, not on the place in a vector or on its length. Arguments
// that the polynomials do not cover (large angles, powers next to the ends of
// the range, infinities, NaN) are left to libm, one by one.
//
// Included by sources that are compiled for one kind of processor each: nothing
// here may be a function that the linker could take for another source's.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_MATH_WIDEFUNCTIONS_H
#define TAI_LIB_RUNTIME_MATH_WIDEFUNCTIONS_H

#define TAI_WIDE_INLINE static inline __attribute__((always_inline))

extern "C" {
float sinf(float);
float cosf(float);
float powf(float, float);
float log1pf(float);
float expf(float);
float exp2f(float);
float logf(float);
float log2f(float);
float log10f(float);
float tanhf(float);
float sinhf(float);
float coshf(float);
}

namespace {
template <int lanes> struct WideLanes {
  typedef float F32 __attribute__((ext_vector_type(lanes)));
  typedef double F64 __attribute__((ext_vector_type(lanes)));
  typedef long I64 __attribute__((ext_vector_type(lanes)));

  TAI_WIDE_INLINE F64 extend(F32 x) { return __builtin_convertvector(x, F64); }
  TAI_WIDE_INLINE F32 truncate(F64 x) {
    return __builtin_convertvector(x, F32);
  }
  TAI_WIDE_INLINE F64 fma(F64 a, F64 b, F64 c) {
    return __builtin_elementwise_fma(a, b, c);
  }
  TAI_WIDE_INLINE I64 bits(F64 x) { return __builtin_bit_cast(I64, x); }
  TAI_WIDE_INLINE F64 number(I64 x) { return __builtin_bit_cast(F64, x); }
  TAI_WIDE_INLINE bool all(I64 mask) { return __builtin_reduce_and(mask) != 0; }

  /// Returns `y` with the sign of `x`, even if `x` is zero.
  TAI_WIDE_INLINE F64 withSignOf(F64 x, F64 y) {
    const I64 sign = 1L << 63;
    return number((bits(x) & sign) | (bits(y) & ~sign));
  }

  /// Evaluates the polynomial c[0] + c[1] x + ... + c[n-1] x^(n-1).
  template <int n> TAI_WIDE_INLINE F64 polynomial(F64 x, const double (&c)[n]) {
    F64 sum = c[n - 1];
    for (int i = n - 2; i >= 0; --i)
      sum = fma(sum, x, F64(c[i]));
    return sum;
  }

  /// Returns the integer nearest to x, in the low bits, for |x| < 2^51.
  /// `rounded`: the integer as a float.
  TAI_WIDE_INLINE I64 round(F64 x, F64 &rounded) {
    const F64 shifter = 0x1.8p52;
    F64 shifted = x + shifter;
    rounded = shifted - shifter;
    return bits(shifted);
  }

  /// Returns sin(x + quarters pi / 2). `covered`: the lanes where the result is
  /// valid.
  TAI_WIDE_INLINE F64 sine(F64 x, long quarters, I64 &covered) {
    // Below this bound on |x|, a reduction by pi / 2 in two parts leaves a
    // remainder that is accurate enough for f32.
    covered = __builtin_elementwise_abs(x) < 0x1p32;
    F64 k;
    I64 turns = round(x * 0x1.45f306dc9c883p-1, k) + quarters;
    F64 r = fma(-k, F64(0x1.921fb54442d18p0), x);
    r = fma(-k, F64(0x1.1a62633145c07p-54), r);
    F64 z = r * r;
    // Taylor series of sine and cosine: the first omitted terms are below
    // 2^-36.
    F64 sine = r * polynomial(z, {1., -1. / 6, 1. / 120, -1. / 5040,
                                  1. / 362880, -1. / 39916800});
    F64 cosine = polynomial(z, {1., -1. / 2, 1. / 24, -1. / 720, 1. / 40320,
                                -1. / 3628800, 1. / 479001600});
    I64 isOdd = -(turns & 1);
    I64 result = (bits(cosine) & isOdd) | (bits(sine) & ~isOdd);
    return number(result ^ ((turns & 2) << 62));
  }

  /// Returns the result as f32 in covered lanes, and the result of libm in the
  /// others.
  template <typename Libm, typename... X>
  TAI_WIDE_INLINE F32 finish(F64 inF64, I64 covered, Libm libm, X... x) {
    F32 result = truncate(inF64);
    if (__builtin_expect(!all(covered), false))
      for (int i = 0; i < lanes; ++i)
        if (!covered[i])
          result[i] = libm(x[i]...);
    return result;
  }

  TAI_WIDE_INLINE F32 sin(F32 x) {
    I64 covered;
    F64 inF64 = sine(extend(x), 0, covered);
    return finish(inF64, covered, sinf, x);
  }
  TAI_WIDE_INLINE F32 cos(F32 x) {
    I64 covered;
    F64 inF64 = sine(extend(x), 1, covered);
    return finish(inF64, covered, cosf, x);
  }

  /// The logarithm to base 2 of a positive normal f64, with a relative error of
  /// 2^-44.
  TAI_WIDE_INLINE F64 binaryLogarithm(F64 x) {
    // The exponent bits of x, relative to sqrt(1/2), hold e in x = 2^e m, where
    // m is between sqrt(1/2) and sqrt(2).
    const I64 rootHalf = 0x3fe6a09e667f3bcd;
    I64 above = bits(x) - rootHalf;
    F64 e = __builtin_convertvector(above >> 52, F64);
    F64 m = number((above & ((1L << 52) - 1)) + rootHalf);
    // The series of 2 artanh(s) / ln 2, whose next term is below 2^-44.
    F64 s = (m - 1.) / (m + 1.);
    F64 z = s * s;
    const double scale = 0x1.71547652b82fep1;
    F64 series = polynomial(z, {scale, scale / 3, scale / 5, scale / 7,
                                scale / 9, scale / 11, scale / 13, scale / 15});
    return fma(s, series, e);
  }

  /// The logarithm of a positive finite number, to the base for which the
  /// logarithm of 2 is `ofTwo`.
  TAI_WIDE_INLINE F32 logarithm(F32 x, double ofTwo, float (*libm)(float)) {
    F64 inF64 = extend(x);
    I64 covered = (inF64 > 0.) & (inF64 < __builtin_inf());
    return finish(binaryLogarithm(inF64) * ofTwo, covered, libm, x);
  }
  TAI_WIDE_INLINE F32 log(F32 x) {
    return logarithm(x, 0x1.62e42fefa39efp-1, logf);
  }
  TAI_WIDE_INLINE F32 log2(F32 x) { return logarithm(x, 1., log2f); }
  TAI_WIDE_INLINE F32 log10(F32 x) {
    return logarithm(x, 0x1.34413509f79ffp-2, log10f);
  }

  TAI_WIDE_INLINE F32 log1p(F32 x) {
    F64 inF64 = extend(x);
    I64 covered = (inF64 > -1.) & (inF64 < __builtin_inf());
    F64 sum = inF64 + 1.;
    // `rest` is the rounding error of the sum, to first order.
    F64 rest = (inF64 - (sum - 1.)) / sum;
    F64 result = fma(binaryLogarithm(sum), F64(0x1.62e42fefa39efp-1), rest);
    return finish(withSignOf(inF64, result), covered, log1pf, x);
  }

  /// 2^x as scale + scale * minusOne for |x| < 1000, where minusOne has a
  /// relative error of 2^-37.
  TAI_WIDE_INLINE F64 splitPower(F64 x, F64 &minusOne) {
    F64 k;
    I64 shifted = round(x, k);
    F64 r = (x - k) * 0x1.62e42fefa39efp-1;
    minusOne =
        r * polynomial(r, {1., 1. / 2, 1. / 6, 1. / 24, 1. / 120, 1. / 720,
                           1. / 5040, 1. / 40320, 1. / 362880});
    return number((shifted << 52) + (1023L << 52));
  }
  TAI_WIDE_INLINE F64 powerOfTwo(F64 x) {
    F64 minusOne, scale = splitPower(x, minusOne);
    return fma(scale, minusOne, scale);
  }

  /// base^x, where `log` is the base's logarithm to base 2. Results that are
  /// denormal or overflow in f32 are left to libm, which sets the flags.
  TAI_WIDE_INLINE F32 power(F32 x, double log, float (*libm)(float)) {
    F64 t = extend(x) * log;
    I64 covered = __builtin_elementwise_abs(t) < 126.;
    // Lanes whose argument is not covered compute 2^0, so that they do not
    // overflow.
    return finish(powerOfTwo(number(bits(t) & covered)), covered, libm, x);
  }
  TAI_WIDE_INLINE F32 exp(F32 x) { return power(x, 0x1.71547652b82fep0, expf); }
  TAI_WIDE_INLINE F32 exp2(F32 x) { return power(x, 1., exp2f); }

  /// e^|x| - 1, which is computed without cancellation. `covered` is set where
  /// sinh and cosh do not overflow in f32; elsewhere the result is 0.
  TAI_WIDE_INLINE F64 exponentialMinusOne(F64 x, I64 &covered) {
    F64 size = __builtin_elementwise_abs(x);
    // The bound on |x| is the logarithm of twice the largest f32, above which
    // the function overflows.
    covered = size < 89.41598;
    size = number(bits(size) & covered);
    F64 minusOne, scale = splitPower(size * 0x1.71547652b82fep0, minusOne);
    return fma(scale, minusOne, scale - 1.);
  }
  /// sinh |x| = (t + t / (t + 1)) / 2 with t = e^|x| - 1.
  TAI_WIDE_INLINE F32 sinh(F32 x) {
    I64 covered;
    F64 inF64 = extend(x), t = exponentialMinusOne(inF64, covered);
    F64 result = 0.5 * (t + t / (t + 1.));
    return finish(withSignOf(inF64, result), covered, sinhf, x);
  }
  /// cosh x = 1 + t^2 / (2 (t + 1)) with t = e^|x| - 1.
  TAI_WIDE_INLINE F32 cosh(F32 x) {
    I64 covered;
    F64 t = exponentialMinusOne(extend(x), covered);
    return finish(1. + 0.5 * t * (t / (t + 1.)), covered, coshf, x);
  }

  /// tanh x = t / (t + 2) with t = e^2x - 1, which is computed without
  /// cancellation.
  TAI_WIDE_INLINE F32 tanh(F32 x) {
    F64 inF64 = extend(x);
    // From |x| = 9.1 on, tanh(x) rounds to 1 in f32.
    I64 covered = __builtin_elementwise_abs(inF64) < 9.5;
    inF64 = number(bits(inF64) & covered);
    F64 minusOne, scale = splitPower(inF64 * 0x1.71547652b82fep1, minusOne);
    F64 t = fma(scale, minusOne, scale - 1.);
    return finish(withSignOf(inF64, t / (t + 2.)), covered, tanhf, x);
  }

  TAI_WIDE_INLINE F32 pow(F32 x, F32 y) {
    F64 wideX = extend(x);
    F64 t = extend(y) * binaryLogarithm(wideX);
    // Every positive f32 is a normal number of f64, so denormals need no
    // special case.
    I64 covered = (wideX > 0.) & (wideX < __builtin_inf()) &
                  (__builtin_elementwise_abs(t) < 126.);
    return finish(powerOfTwo(number(bits(t) & covered)), covered, powf, x, y);
  }
};
} // namespace

/// Defines a function of one argument for `lanes` numbers at once.
#define TAI_DEFINE_WIDE_1(name, lanes)                                         \
  extern "C" WideLanes<lanes>::F32 tai_wide_##name##_##lanes(                  \
      WideLanes<lanes>::F32 x) {                                               \
    return WideLanes<lanes>::name(x);                                          \
  }
#define TAI_DEFINE_WIDE_2(name, lanes)                                         \
  extern "C" WideLanes<lanes>::F32 tai_wide_##name##_##lanes(                  \
      WideLanes<lanes>::F32 x, WideLanes<lanes>::F32 y) {                      \
    return WideLanes<lanes>::name(x, y);                                       \
  }

#endif // TAI_LIB_RUNTIME_MATH_WIDEFUNCTIONS_H
