//===- Philox.h - Counter-based random numbers ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Philox 4x32-10, written from its definition in J. K. Salmon, M. A. Moraes, R.
// O. Dror, D. E. Shaw, "Parallel random numbers: as easy as 1, 2, 3" (SC 2011).
// A number depends on its counter and key alone, not on the thread or the order
// of draws.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_SUPPORT_PHILOX_H
#define TAI_SUPPORT_PHILOX_H

#include <stdint.h>
// Device code includes this header too, and has no C++ library.
#if __STDC_HOSTED__
#include <array>
#endif

namespace mlir::tai::runtime {

/// Replaces the counter by the random bits that belong to it.
inline void philox4x32InPlace(uint32_t (&counter)[4], uint32_t key0,
                              uint32_t key1, int rounds = 10) {
  constexpr uint32_t multiplier0 = 0xD2511F53, multiplier1 = 0xCD9E8D57;
  constexpr uint32_t weyl0 = 0x9E3779B9, weyl1 = 0xBB67AE85;
  for (int round = 0; round < rounds; ++round) {
    uint64_t product0 = uint64_t(multiplier0) * counter[0];
    uint64_t product1 = uint64_t(multiplier1) * counter[2];
    uint32_t bits0 = uint32_t(product1 >> 32) ^ counter[1] ^ key0;
    uint32_t bits2 = uint32_t(product0 >> 32) ^ counter[3] ^ key1;
    counter[0] = bits0;
    counter[1] = uint32_t(product1);
    counter[2] = bits2;
    counter[3] = uint32_t(product0);
    key0 += weyl0;
    key1 += weyl1;
  }
}

#if __STDC_HOSTED__
inline std::array<uint32_t, 4> philox4x32(std::array<uint32_t, 4> counter,
                                          std::array<uint32_t, 2> key,
                                          int rounds = 10) {
  uint32_t bits[4] = {counter[0], counter[1], counter[2], counter[3]};
  philox4x32InPlace(bits, key[0], key[1], rounds);
  return {bits[0], bits[1], bits[2], bits[3]};
}
#endif

/// The random bits that tai_rt_random_u32 returns for a draw of a kernel.
inline uint32_t randomBits(uint64_t seed, uint64_t launch, uint64_t iteration,
                           uint32_t stream, uint32_t sequence) {
  // The position of a draw (launch, iteration, stream, sequence) has 192 bits,
  // the counter 128. So the launch goes into the key, combined with a bijection
  // of the seed, so that launches of one context never share a key. Four
  // consecutive numbers of a sequence are one block of Philox.
  uint64_t key = seed + 0x9E3779B97F4A7C15u;
  key = (key ^ (key >> 30)) * 0xBF58476D1CE4E5B9u;
  key = (key ^ (key >> 27)) * 0x94D049BB133111EBu;
  key = (key ^ (key >> 31)) ^ launch;
  uint32_t bits[4] = {uint32_t(iteration), uint32_t(iteration >> 32), stream,
                      sequence >> 2};
  philox4x32InPlace(bits, uint32_t(key), uint32_t(key >> 32));
  uint32_t which = sequence & 3;
  // Selects one of four words without an index into memory, for which a GPU
  // would need the stack.
  return which < 2 ? (which == 0 ? bits[0] : bits[1])
                   : (which == 2 ? bits[2] : bits[3]);
}

} // namespace mlir::tai::runtime

#endif // TAI_SUPPORT_PHILOX_H
