//===- WideAvx512.cpp - Functions of vectors for processors with AVX-512 --===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#if defined(__x86_64__)

#include "WideF64.h"

#define TAI_WIDE_FUNCTION(name, arguments) TAI_DEFINE_WIDE_##arguments(name, 16)
#define TAI_WIDE_F64_FUNCTION(name) TAI_DEFINE_WIDE_F64(name, 8)
#include "tai/ABI/VectorMath.def"

#endif
