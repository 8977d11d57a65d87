//===- Ordered.cpp - Additions of a warp in a fixed order -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Called by all threads of one warp together. Lanes with the same address
// reduce their values by a pairwise tree in the order of lanes; the lowest of
// them adds the sum to memory. The order depends only on which lanes have which
// address.
//
//===----------------------------------------------------------------------===//

#include "Warp.h"
#include "tai/ABI/DeviceAbi.h"

using namespace tai::device;

// The encoding of a lane's plan: a byte for each round of the reduction, with
// the lane whose sum this lane adds to its own, and the bit `takes` if there is
// such a lane; then the number of rounds of the warp, and the bit `writes` if
// this lane writes the sum to memory.
static constexpr unsigned roundBits = 8, countShift = 48;
static constexpr uint64_t takes = 32, writes = uint64_t(1) << 63;

uint32_t tai_dev_ordered_lanes() {
#ifndef __NVPTX__
  // With one thread in a block, that thread runs the iterations in order, and
  // makes all additions.
  if (tai_dev_block_dim() == 1)
    return 1;
#endif
  // All threads of a warp must call the functions below together.
  if (static_cast<unsigned>(tai_dev_block_dim()) < warpSize)
    __builtin_trap();
  return warpSize;
}

void tai_dev_ordered_meet() { syncWarp(); }

uint64_t tai_dev_ordered_plan(const void *address) {
#ifndef __NVPTX__
  if (tai_dev_block_dim() == 1)
    return address ? writes : 0;
#endif
  // A barrier: what lanes read before this call must be read before any lane
  // writes.
  syncWarp();
  auto bits = reinterpret_cast<uint64_t>(address);
  uint32_t same = matchAny(bits);
  auto lane = getLane();
  // A lane that adds nothing takes the sum of no other lane.
  uint32_t above = address ? same & ~((uint32_t(2) << lane) - 1) : 0;
  uint32_t next = above ? takes | __builtin_ctz(above) : lane;
  bool isLowest = address && !(same & ((uint32_t(1) << lane) - 1));
  uint64_t plan = isLowest ? writes : 0, rounds = 0;
  while (voteAny((next & takes) != 0)) {
    plan |= uint64_t(next) << rounds * roundBits;
    ++rounds;
    uint32_t after = exchange(next, next & (warpSize - 1));
    next = next & takes ? after : next;
  }
  return plan | rounds << countShift;
}

template <typename T> static void add(uint64_t plan, T *target, T value) {
  uint32_t rounds = static_cast<uint32_t>(plan >> countShift) & 7;
  for (uint32_t round = 0; round < rounds; ++round) {
    auto next = static_cast<uint32_t>(plan >> round * roundBits);
    T other = exchange(value, next & (warpSize - 1));
    if (next & takes)
      value += other;
  }
  if (plan & writes)
    *target += value;
  // A barrier: in the next addition, another lane may write to the same
  // element.
  syncWarp();
}

void tai_dev_ordered_add_f32(uint64_t plan, float *target, float value) {
  add(plan, target, value);
}

void tai_dev_ordered_add_f64(uint64_t plan, double *target, double value) {
  add(plan, target, value);
}

//===----------------------------------------------------------------------===//
// Sums in the order of lanes
//===----------------------------------------------------------------------===//

// tai_dev_ordered_turns returns the number of rounds of the warp. In the lowest
// lane of an address, the result also has the mask of the other lanes with this
// address, in the low bits, and the bit `writes`.

uint64_t tai_dev_ordered_turns(const void *address) {
#ifndef __NVPTX__
  if (tai_dev_block_dim() == 1)
    return address ? writes : 0;
#endif
  // A barrier: what lanes read before this call must be read before any lane
  // writes.
  syncWarp();
  uint32_t same = matchAny(reinterpret_cast<uint64_t>(address));
  auto lane = getLane();
  bool isLowest = address && !(same & ((uint32_t(1) << lane) - 1));
  uint32_t others = isLowest ? same & ~(uint32_t(1) << lane) : 0;
  uint64_t rounds = 0;
  for (uint32_t left = others; voteAny(left != 0); left &= left - 1)
    ++rounds;
  return (isLowest ? writes : 0) | rounds << countShift | others;
}

template <typename T> static void append(uint64_t turns, T *target, T value) {
  auto left = static_cast<uint32_t>(turns);
  uint32_t rounds = static_cast<uint32_t>(turns >> countShift) & 31;
  T sum = turns & writes ? *target + value : value;
  for (uint32_t round = 0; round < rounds; ++round) {
    T next = exchange(value, left ? __builtin_ctz(left) : getLane());
    if (left)
      sum += next;
    left &= left - 1;
  }
  if (turns & writes)
    *target = sum;
  // A barrier: in the next addition, another lane may write to the same
  // element.
  syncWarp();
}

void tai_dev_ordered_append_f32(uint64_t turns, float *target, float value) {
  append(turns, target, value);
}

void tai_dev_ordered_append_f64(uint64_t turns, double *target, double value) {
  append(turns, target, value);
}
