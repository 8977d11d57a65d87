//===- WideAvx2.cpp - Functions of vectors for processors with AVX2 -------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#if defined(__x86_64__)

#include "WideFunctions.h"

TAI_DEFINE_WIDE_1(sin, 4)
TAI_DEFINE_WIDE_1(cos, 4)
TAI_DEFINE_WIDE_2(pow, 4)
TAI_DEFINE_WIDE_1(log1p, 4)
TAI_DEFINE_WIDE_1(sin, 8)
TAI_DEFINE_WIDE_1(cos, 8)
TAI_DEFINE_WIDE_2(pow, 8)
TAI_DEFINE_WIDE_1(log1p, 8)

/// For what is left of a loop: the bits of the vector forms.
extern "C" float tai_wide_sin_1(float x) { return Wide<4>::sin(x)[0]; }
extern "C" float tai_wide_cos_1(float x) { return Wide<4>::cos(x)[0]; }
extern "C" float tai_wide_pow_1(float x, float y) {
  return Wide<4>::pow(x, y)[0];
}
extern "C" float tai_wide_log1p_1(float x) { return Wide<4>::log1p(x)[0]; }

#endif
