//===- XXHash.h - A fast hash of 64 bits ------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// XXH64, written from its specification. It needs no library: the runtime does
// not use LLVM, and the Python module, which hashes arrays, uses only the C
// API.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_SUPPORT_XXHASH_H
#define TAI_SUPPORT_XXHASH_H

#include <cstddef>
#include <cstdint>
#include <cstring>

namespace mlir::tai::runtime {

/// The XXH64 hash of `length` bytes, which is not cryptographic.
inline uint64_t xxh64(const void *data, size_t length, uint64_t seed = 0) {
  constexpr uint64_t prime1 = 0x9E3779B185EBCA87u;
  constexpr uint64_t prime2 = 0xC2B2AE3D27D4EB4Fu;
  constexpr uint64_t prime3 = 0x165667B19E3779F9u;
  constexpr uint64_t prime4 = 0x85EBCA77C2B2AE63u;
  constexpr uint64_t prime5 = 0x27D4EB2F165667C5u;
  auto rotateLeft = [](uint64_t value, int by) {
    return value << by | value >> (64 - by);
  };
  const char *at = static_cast<const char *>(data);
  const char *end = at + length;
  auto next64 = [&] {
    uint64_t lane;
    std::memcpy(&lane, at, 8);
    at += 8;
    return lane;
  };
  auto round = [&](uint64_t sum, uint64_t lane) {
    return rotateLeft(sum + lane * prime2, 31) * prime1;
  };
  uint64_t hash;
  if (length >= 32) {
    uint64_t sums[4] = {seed + prime1 + prime2, seed + prime2, seed,
                        seed - prime1};
    while (end - at >= 32)
      for (uint64_t &sum : sums)
        sum = round(sum, next64());
    hash = rotateLeft(sums[0], 1) + rotateLeft(sums[1], 7) +
           rotateLeft(sums[2], 12) + rotateLeft(sums[3], 18);
    for (uint64_t sum : sums)
      hash = (hash ^ round(0, sum)) * prime1 + prime4;
  } else {
    hash = seed + prime5;
  }
  hash += length;
  while (end - at >= 8)
    hash = rotateLeft(hash ^ round(0, next64()), 27) * prime1 + prime4;
  if (end - at >= 4) {
    uint32_t lane;
    std::memcpy(&lane, at, 4);
    at += 4;
    hash = rotateLeft(hash ^ lane * prime1, 23) * prime2 + prime3;
  }
  while (at != end)
    hash = rotateLeft(hash ^ static_cast<unsigned char>(*at++) * prime5, 11) *
           prime1;
  hash = (hash ^ hash >> 33) * prime2;
  hash = (hash ^ hash >> 29) * prime3;
  return hash ^ hash >> 32;
}

} // namespace mlir::tai::runtime

#endif // TAI_SUPPORT_XXHASH_H
