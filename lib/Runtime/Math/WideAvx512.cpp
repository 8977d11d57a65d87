//===- WideAvx512.cpp - Functions of vectors for processors with AVX-512 --===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#if defined(__x86_64__)

#include "WideFunctions.h"

TAI_DEFINE_WIDE_1(sin, 16)
TAI_DEFINE_WIDE_1(cos, 16)
TAI_DEFINE_WIDE_2(pow, 16)
TAI_DEFINE_WIDE_1(log1p, 16)

#endif
