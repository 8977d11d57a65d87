//===- WideSums.cpp - Sums with twice the digits of their terms -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Sums in f64 of narrower floats, and sums of f64 with their rounding errors in
// a second f64. An atomic addition returns the former value, from which the
// rounding error of the addition follows exactly (Knuth, TAOCP 4.2.2, theorem
// B). The errors add up in any order.
//
// If all lanes of a warp add to one sum, they combine their terms first: atomic
// operations on one address run one after another.
//
//===----------------------------------------------------------------------===//

#include "Warp.h"
#include "tai/ABI/DeviceAbi.h"

using namespace tai::device;

/// Returns a + b, rounded. With a plain addition, the compiler could fuse a
/// product in `a` or `b` into it, while atomics add the rounded product.
static double add(double a, double b) {
#ifdef __NVPTX__
  return __nvvm_add_rn_d(a, b);
#else
  return a + b;
#endif
}

/// The rounding error of the addition a + b, whose rounded result is `sum`.
static double getError(double a, double b, double sum) {
  double partB = add(sum, -a);
  return add(add(a, -add(sum, -partB)), add(b, -partB));
}

void tai_dev_wide_add_f32(double *sum, double term) {
  if (isSameInWarp(reinterpret_cast<uint64_t>(sum))) {
    term = combineInWarp(term, add);
    if (getLane() != 0)
      return;
  }
  if (term != 0)
    atomicAdd(sum, term);
}

void tai_dev_wide_add_f64(double *sums, double term) {
  double error = 0;
  if (isSameInWarp(reinterpret_cast<uint64_t>(sums))) {
#pragma unroll
    for (unsigned offset = warpSize / 2; offset; offset /= 2) {
      double other = exchange(term, getLane() ^ offset);
      double otherError = exchange(error, getLane() ^ offset);
      double both = add(term, other);
      error = add(error, add(otherError, getError(term, other, both)));
      term = both;
    }
    if (getLane() != 0)
      return;
  }
  if (term == 0 && error == 0)
    return;
  double before = atomicAdd(sums, term);
  atomicAdd(sums + 1, add(error, getError(before, term, add(before, term))));
}

double tai_dev_wide_take_f64(double *sums, double element) {
  double sum = sums[0], total = add(element, sum);
  double error = add(sums[1], getError(element, sum, total));
  sums[0] = sums[1] = 0;
  // If the total is infinite or NaN, the rounding error has no meaning and is
  // dropped.
  return total - total == 0 ? add(total, error) : total;
}
