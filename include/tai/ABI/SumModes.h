//===- SumModes.h - Sums of kernels that name their mode --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What only kernels with a mode of sums ask of the runtime, besides Abi.h.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ABI_SUMMODES_H
#define TAI_ABI_SUMMODES_H

#include "tai/ABI/Abi.h"

/// A field of f64, and private buffers of pairs of f64: a sum, and what it has
/// rounded away. One more of the kinds of `tai_rt_combine`.
enum { kSumsPairs = kSumsWide + 1 };

/// Of `tai_rt_parts`: the parts follow from the loop alone, whatever the
/// context says. 1 is for loops that reduce.
enum { kPartsFixed = 2 };

#endif // TAI_ABI_SUMMODES_H
