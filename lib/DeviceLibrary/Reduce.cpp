//===- Reduce.cpp - Reductions over the threads of a block ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Reductions over a block: by shuffles within a warp, through shared memory
// between warps, and by one atomic operation for the block.
//
//===----------------------------------------------------------------------===//

#include "Target.h"
#include "tai/ABI/DeviceAbi.h"

using namespace tai::device;

//===----------------------------------------------------------------------===//
// Operations
//===----------------------------------------------------------------------===//

namespace {
struct Add {
  template <typename T> static T combine(T a, T b) { return a + b; }
};
struct Mul {
  template <typename T> static T combine(T a, T b) { return a * b; }
};
struct Min {
  template <typename T> static T combine(T a, T b) { return b < a ? b : a; }
  static float combine(float a, float b) {
    return __builtin_elementwise_minimum(a, b);
  }
  static double combine(double a, double b) {
    return __builtin_elementwise_minimum(a, b);
  }
};
struct Max {
  template <typename T> static T combine(T a, T b) { return a < b ? b : a; }
  static float combine(float a, float b) {
    return __builtin_elementwise_maximum(a, b);
  }
  static double combine(double a, double b) {
    return __builtin_elementwise_maximum(a, b);
  }
};
struct And {
  template <typename T> static T combine(T a, T b) { return a & b; }
};
struct Or {
  template <typename T> static T combine(T a, T b) { return a | b; }
};
struct Xor {
  template <typename T> static T combine(T a, T b) { return a ^ b; }
};

template <unsigned bytes> struct BitsOf;
template <> struct BitsOf<4> {
  using Type = uint32_t;
};
template <> struct BitsOf<8> {
  using Type = uint64_t;
};
} // namespace

template <typename To, typename From> static To bitCast(From from) {
  static_assert(sizeof(To) == sizeof(From), "the same bits");
  return __builtin_bit_cast(To, from);
}

/// Updates `target` by compare-and-exchange, repeated until no other thread has
/// written in between.
template <typename Op, typename T>
static void updateInLoop(T *target, T value) {
  using Bits = typename BitsOf<sizeof(T)>::Type;
  auto *bits = reinterpret_cast<Bits *>(target);
  Bits seen = atomicRead(bits);
  for (;;) {
    auto wanted = bitCast<Bits>(Op::combine(bitCast<T>(seen), value));
    // If the value does not change, as in most minima and maxima, no exchange
    // is needed.
    if (wanted == seen || atomicReplace(bits, seen, wanted))
      return;
  }
}

#define TAI_FETCH(op)                                                          \
  (void)__scoped_atomic_fetch_##op(target, value, __ATOMIC_RELAXED,            \
                                   __MEMORY_SCOPE_DEVICE)

template <typename T> static void update(Add, T *target, T value) {
  TAI_FETCH(add);
}
template <typename T> static void update(Mul, T *target, T value) {
  updateInLoop<Mul>(target, value);
}
template <typename T> static void update(Min, T *target, T value) {
  TAI_FETCH(min);
}
template <typename T> static void update(Max, T *target, T value) {
  TAI_FETCH(max);
}
static void update(Min, float *target, float value) {
  updateInLoop<Min>(target, value);
}
static void update(Min, double *target, double value) {
  updateInLoop<Min>(target, value);
}
static void update(Max, float *target, float value) {
  updateInLoop<Max>(target, value);
}
static void update(Max, double *target, double value) {
  updateInLoop<Max>(target, value);
}
template <typename T> static void update(And, T *target, T value) {
  TAI_FETCH(and);
}
template <typename T> static void update(Or, T *target, T value) {
  TAI_FETCH(or);
}
template <typename T> static void update(Xor, T *target, T value) {
  TAI_FETCH(xor);
}
#undef TAI_FETCH

//===----------------------------------------------------------------------===//
// Blocks
//===----------------------------------------------------------------------===//

/// Shared memory of a reduction, with a slot for each warp of the block.
TAI_SHARED_VARIABLE static uint64_t warpValues[warpSize];

static uint64_t shuffleDown(uint32_t mask, uint64_t value, unsigned offset) {
  uint64_t low = shuffleDown(mask, static_cast<uint32_t>(value), offset);
  uint64_t high = shuffleDown(mask, static_cast<uint32_t>(value >> 32), offset);
  return high << 32 | low;
}

/// Lane 0 gets the combination of the first `count` lanes. All lanes of `mask`
/// must call this function together.
template <typename Op, typename T>
static T reduceWarp(uint32_t mask, unsigned lane, unsigned count, T value) {
  using Bits = typename BitsOf<sizeof(T)>::Type;
#pragma unroll
  for (unsigned offset = warpSize / 2; offset; offset /= 2) {
    T other = bitCast<T>(shuffleDown(mask, bitCast<Bits>(value), offset));
    T combined = Op::combine(value, other);
    value = lane + offset < count ? combined : value;
  }
  return value;
}

template <typename Op, typename T> static void reduce(T *target, T value) {
  auto thread = static_cast<unsigned>(tai_dev_thread_id());
  auto threads = static_cast<unsigned>(tai_dev_block_dim());
#ifndef __NVPTX__
  if (threads == 1)
    return update(Op(), target, value);
#endif
  unsigned lane = thread % warpSize, warp = thread / warpSize;
  unsigned warps = (threads + warpSize - 1) / warpSize;
  unsigned left = threads - warp * warpSize;
  unsigned count = left < warpSize ? left : warpSize;
  uint32_t mask = ~uint32_t(0) >> (warpSize - count);
  value = reduceWarp<Op>(mask, lane, count, value);
  if (warps > 1) {
    auto *slots = (TAI_SHARED T *)warpValues;
    constexpr unsigned stride = sizeof(uint64_t) / sizeof(T);
    if (lane == 0)
      slots[warp * stride] = value;
    syncBlock();
    if (warp == 0) {
      value = slots[(lane < warps ? lane : 0) * stride];
      value = reduceWarp<Op>(wholeWarp, lane, warps, value);
    }
    // Wait, so that the slots in shared memory are free for the next reduction.
    syncBlock();
  }
  if (thread == 0)
    update(Op(), target, value);
}

#define TAI_OP_add Add
#define TAI_OP_mul Mul
#define TAI_OP_min Min
#define TAI_OP_max Max
#define TAI_OP_and And
#define TAI_OP_or Or
#define TAI_OP_xor Xor
#define TAI_DEVICE_REDUCTION(op, suffix, type)                                 \
  void tai_dev_reduce_##op##_##suffix(type *target, type value) {              \
    reduce<TAI_OP_##op>(target, value);                                        \
  }
#include "tai/ABI/DeviceReductions.def"
