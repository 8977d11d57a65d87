//===- MeshAbi.h - Exchanges of compiled kernels ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The functions by which kernels over sharded fields communicate. They are
// apart from Abi.h because only code for the CPU calls them.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ABI_MESHABI_H
#define TAI_ABI_MESHABI_H

#include "tai/ABI/Abi.h"

extern "C" {

/// A digit of the indices of a field: (x / divisor) % extent of an index x,
/// with `stride` bytes from one value to the next. `role`: the number of the
/// fixed index that the digit is of, or one of the values below.
enum { TAI_DIGIT_FREE = -1, TAI_DIGIT_ROW = -2 };
typedef struct TaiExchangeDigit {
  int64_t role, divisor, extent, stride;
} TaiExchangeDigit;

/// An exchange of a kernel, followed in memory by `numDigits` digits. `kind` is
/// an ExchangeKind of the dialect of meshes. `element` is the type of a number:
/// the bits of an integer, minus the bits of a float, -17 for bf16. The digit
/// of the rows, if any, is the whole index; a rank owns `block` rows. `offset`
/// is the position of the field in its tree, in bytes.
typedef struct TaiExchangePlan {
  int64_t kind, element, digest, block, before, after, offset, numDigits;
} TaiExchangePlan;

/// The number of this process in its mesh. Fails the launch, and returns 0, if
/// the mesh has not `ranks` ranks; `where` is as for tai_rt_fail.
int64_t tai_rt_rank(TaiFrame *frame, int64_t ranks, const char *where);

/// Communicates with the other ranks about a field of the tree at `tree`, as
/// `plan` says; `at` holds the fixed indices, counted from the first one of
/// their dimension.
void tai_rt_exchange(TaiFrame *frame, void *tree, const TaiExchangePlan *plan,
                     const int64_t *at, const char *field, const char *where);

} // extern "C"

#endif // TAI_ABI_MESHABI_H
