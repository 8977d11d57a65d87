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

/// A further mode of `tai_rt_combine`: the field is f64, and the private
/// buffers hold pairs of f64, first the sums, then their rounding errors
/// (compensated summation).
enum { kSumsPairs = kSumsWide + 1 };
/// Further modes of `tai_rt_combine`: fields of 16-bit floats, with private
/// buffers of f64.
enum { kSumsF16 = kSumsPairs + 1, kSumsBF16 };
/// Further modes of `tai_rt_combine`: fields of 32-bit and 64-bit integers,
/// with private buffers of the same type.
enum { kSumsI32 = kSumsBF16 + 1, kSumsI64 };

/// A further value of the argument of `tai_rt_parts` that is 0, or 1 for loops
/// with reductions: the partition then depends on the loop alone, whatever the
/// options of the context.
enum { kPartsFixed = 2 };

namespace mlir::tai::runtime {
/// Name of an attribute of functions in which the plan of reductions lets LLVM
/// choose the order of sums. The pass WidenSums then keeps sums of f32 in f64.
inline constexpr char kFreeSumsAttrName[] = "tai.free_sums";
} // namespace mlir::tai::runtime

#endif // TAI_ABI_SUMMODES_H
