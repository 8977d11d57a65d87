//===- WideAvx2.cpp - Functions of vectors for processors with AVX2 -------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#if defined(__x86_64__)

#include "WideF64.h"

// The scalar functions are for the remainder iterations of a vectorized loop.
// Their results have the same bits as the results of the vector functions.
#define TAI_DEFINE_1(name)                                                     \
  TAI_DEFINE_WIDE_1(name, 4)                                                   \
  TAI_DEFINE_WIDE_1(name, 8)                                                   \
  extern "C" float tai_wide_##name##_1(float x) {                              \
    return WideLanes<4>::name(x)[0];                                           \
  }
#define TAI_DEFINE_2(name)                                                     \
  TAI_DEFINE_WIDE_2(name, 4)                                                   \
  TAI_DEFINE_WIDE_2(name, 8)                                                   \
  extern "C" float tai_wide_##name##_1(float x, float y) {                     \
    return WideLanes<4>::name(x, y)[0];                                        \
  }
#define TAI_WIDE_FUNCTION(name, arguments) TAI_DEFINE_##arguments(name)
#define TAI_WIDE_F64_FUNCTION(name)                                            \
  TAI_DEFINE_WIDE_F64(name, 2)                                                 \
  TAI_DEFINE_WIDE_F64(name, 4)                                                 \
  extern "C" double tai_wide_##name##_f64_1(double x) {                        \
    return WideF64<2>::name(x)[0];                                             \
  }
#include "tai/ABI/VectorMath.def"

#endif
