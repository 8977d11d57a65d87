//===- SumModes.h - Sums of kernels that name their mode --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Additions to Abi.h for kernels that name the mode of their sums, for sums of
// 16 bits and for sums of integers.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ABI_SUMMODES_H
#define TAI_ABI_SUMMODES_H

#include "tai/ABI/Abi.h"

/// A further kind of `tai_rt_combine`: a field of f64 with private buffers of
/// pairs of f64, first the sums, then their rounding errors (compensated
/// summation).
enum { kSumsPairs = kSumsWide + 1 };
/// Fields of 16 bits with private buffers of f64.
enum { kSumsF16 = kSumsPairs + 1, kSumsBF16 };
/// Fields of integers of 32 and 64 bits with private buffers of the same type.
enum { kSumsI32 = kSumsBF16 + 1, kSumsI64 };

/// An argument of `tai_rt_parts`, besides 0 and, for reductions, 1: the
/// partition depends on the loop alone, whatever the options of the context.
enum { kPartsFixed = 2 };

namespace mlir::tai::runtime {
/// Attribute of functions in which the plan of reductions lets LLVM choose the
/// order of sums: sums of f32 are then kept in f64 (`WidenSums`).
inline constexpr char kFreeSumsAttrName[] = "tai.free_sums";
} // namespace mlir::tai::runtime

#endif // TAI_ABI_SUMMODES_H
