//===- Target.h - Primitives of the target processor ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The differences between a GPU and the CPU that emulates it, in one place.
// Neither a C++ library nor a C library is available, except malloc and free,
// which the GPU driver has too.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_DEVICELIBRARY_TARGET_H
#define TAI_LIB_DEVICELIBRARY_TARGET_H

#include <stddef.h>
#include <stdint.h>

extern "C" {
#ifdef __NVPTX__
void *malloc(size_t bytes);
void free(void *memory);
#else
int32_t tai_emu_thread_id(void);
void tai_emu_block_barrier(void);
void tai_emu_warp_barrier(void);
uint64_t tai_emu_exchange(uint64_t value, uint32_t from);
uint32_t tai_emu_match(uint64_t value);
// A heap with a limit, like that of a GPU.
void *tai_emu_allocate(uint64_t bytes);
void tai_emu_free(void *memory);
void tai_emu_look(uint32_t *stop);
int sched_yield(void);
#endif
}

namespace tai::device {

constexpr unsigned warpSize = 32;
constexpr uint32_t wholeWarp = ~uint32_t(0);

// Shared memory of a block, and barriers of blocks and warps. Blocks of the
// emulated device run one after another, so a static variable serves all
// blocks.
#ifdef __NVPTX__
#define TAI_SHARED __attribute__((address_space(3)))
#define TAI_SHARED_VARIABLE TAI_SHARED __attribute__((loader_uninitialized))
inline void syncBlock() { __syncthreads(); }
inline void syncWarp() { __nvvm_bar_warp_sync(wholeWarp); }
inline uint32_t getLane() {
  return static_cast<uint32_t>(__nvvm_read_ptx_sreg_laneid());
}
/// The value that lane `from` passes; `value` itself if there is no such lane.
inline uint32_t shuffle(uint32_t mask, uint32_t value, unsigned from) {
  return static_cast<uint32_t>(
      __nvvm_shfl_sync_idx_i32(mask, static_cast<int32_t>(value),
                               static_cast<int32_t>(from), warpSize - 1));
}
inline uint32_t shuffleDown(uint32_t mask, uint32_t value, unsigned offset) {
  return static_cast<uint32_t>(__nvvm_shfl_sync_down_i32(
      mask, static_cast<int>(value), static_cast<int>(offset), warpSize - 1));
}
/// matchAny: the mask of lanes with the same value. voteAny: whether any lane
/// passes true.
inline uint32_t matchAny(uint64_t value) {
  return __nvvm_match_any_sync_i64(wholeWarp, value);
}
inline bool voteAny(bool mine) { return __nvvm_vote_any_sync(wholeWarp, mine); }
/// True if all lanes of the warp are active and pass the same value.
inline bool isSameInWarp(uint64_t value) {
  uint32_t active = __nvvm_activemask();
  int isSame = 0;
  __nvvm_match_all_sync_i64p(active, static_cast<long long>(value), &isSame);
  return isSame && active == wholeWarp;
}
#else
#define TAI_SHARED
#define TAI_SHARED_VARIABLE
inline void syncBlock() { tai_emu_block_barrier(); }
inline void syncWarp() { tai_emu_warp_barrier(); }
inline uint32_t getLane() {
  return static_cast<uint32_t>(tai_emu_thread_id()) % warpSize;
}
inline uint32_t shuffle(uint32_t, uint32_t value, unsigned from) {
  return static_cast<uint32_t>(tai_emu_exchange(value, from));
}
inline uint32_t shuffleDown(uint32_t, uint32_t value, unsigned offset) {
  return static_cast<uint32_t>(tai_emu_exchange(value, getLane() + offset));
}
inline uint32_t matchAny(uint64_t value) { return tai_emu_match(value); }
inline bool voteAny(bool mine) {
  return tai_emu_match(mine) != wholeWarp || mine;
}
/// Emulated lanes run one after another: whether all are here is not known.
inline bool isSameInWarp(uint64_t) { return false; }
#endif

/// Reads the host's request to stop. The read is volatile, because the host
/// writes to this address at any time.
#ifdef __NVPTX__
inline uint32_t lookAt(uint32_t *stop) {
  return *static_cast<volatile uint32_t *>(stop);
}
#else
inline uint32_t lookAt(uint32_t *stop) {
  tai_emu_look(stop);
  return *stop;
}
#endif

#ifdef __NVPTX__
inline void *allocateBytes(uint64_t bytes) { return malloc(bytes); }
inline void freeBytes(void *memory) { free(memory); }
#else
inline void *allocateBytes(uint64_t bytes) { return tai_emu_allocate(bytes); }
inline void freeBytes(void *memory) { tai_emu_free(memory); }
#endif

/// For each converged thread of the warp in turn, all converged threads run
/// body(values, all, thread, threads) with the values of that thread; `thread`
/// numbers them from 0 to threads - 1. `all.meet()` is a barrier for them.
#ifdef __NVPTX__
struct Together {
  uint32_t mask;
  void meet() const { __nvvm_bar_warp_sync(mask); }
};
template <int count, typename Body>
inline void forEachTogether(const uint64_t (&own)[count], const Body &body) {
  Together all{__nvvm_activemask()};
  auto lane = static_cast<uint32_t>(__nvvm_read_ptx_sreg_laneid());
  int thread = __builtin_popcount(all.mask & ((uint32_t(1) << lane) - 1));
  int threads = __builtin_popcount(all.mask);
  for (uint32_t rest = all.mask; rest; rest &= rest - 1) {
    int from = __builtin_ctz(rest);
    uint64_t values[count];
    for (int i = 0; i < count; ++i) {
      auto low = static_cast<uint32_t>(__nvvm_shfl_sync_idx_i32(
          all.mask, static_cast<int32_t>(own[i]), from, warpSize - 1));
      auto high = static_cast<uint32_t>(__nvvm_shfl_sync_idx_i32(
          all.mask, static_cast<int32_t>(own[i] >> 32), from, warpSize - 1));
      values[i] = uint64_t(high) << 32 | low;
    }
    body(values, all, thread, threads);
  }
  all.meet();
}
#else
struct Together {
  void meet() const {}
};
template <int count, typename Body>
inline void forEachTogether(const uint64_t (&own)[count], const Body &body) {
  body(own, Together(), 0, 1);
}
#endif

/// Atomic operations, relaxed, with the scope of the device. They return the
/// previous value.
template <typename T> inline T atomicAdd(T *target, T value) {
  return __scoped_atomic_fetch_add(target, value, __ATOMIC_RELAXED,
                                   __MEMORY_SCOPE_DEVICE);
}

template <typename T> inline T atomicMax(T *target, T value) {
  return __scoped_atomic_fetch_max(target, value, __ATOMIC_RELAXED,
                                   __MEMORY_SCOPE_DEVICE);
}

template <typename T> inline T atomicOr(T *target, T bits) {
  return __scoped_atomic_fetch_or(target, bits, __ATOMIC_RELAXED,
                                  __MEMORY_SCOPE_DEVICE);
}

template <typename T> inline T atomicAnd(T *target, T bits) {
  return __scoped_atomic_fetch_and(target, bits, __ATOMIC_RELAXED,
                                   __MEMORY_SCOPE_DEVICE);
}

template <typename T> inline T atomicExchange(T *target, T value) {
  return __scoped_atomic_exchange_n(target, value, __ATOMIC_RELAXED,
                                    __MEMORY_SCOPE_DEVICE);
}

template <typename T> inline T atomicRead(T *source) {
  return __scoped_atomic_load_n(source, __ATOMIC_RELAXED,
                                __MEMORY_SCOPE_DEVICE);
}

/// A compare-and-exchange of `*target` from `seen` to `value`. If it fails, it
/// sets `seen` to the current value.
template <typename T> inline bool atomicReplace(T *target, T &seen, T value) {
  return __scoped_atomic_compare_exchange_n(target, &seen, value, /*weak=*/true,
                                            __ATOMIC_RELAXED, __ATOMIC_RELAXED,
                                            __MEMORY_SCOPE_DEVICE);
}

} // namespace tai::device

#endif // TAI_LIB_DEVICELIBRARY_TARGET_H
