//===- LaunchAccesses.h - Elements that a launch accesses -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The elements that a kernel accesses, in terms of its arguments, as the
// compiler found them; the runtime computes the elements from the arguments of
// a launch.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ABI_LAUNCHACCESSES_H
#define TAI_ABI_LAUNCHACCESSES_H

#include <algorithm>
#include <cstdint>
#include <vector>

namespace mlir::tai::runtime {

enum class AccessKind : uint8_t { Read, Write, Accumulate };

/// The signed number that the low `bits` bits of `number` hold.
inline int64_t signExtend(uint64_t number, int64_t bits) {
  auto unused = static_cast<unsigned>(64 - bits);
  return static_cast<int64_t>(number << unused) >> unused;
}

/// A summand of an index: a signed integer argument of the launch, which has
/// `bits` bits, times a factor.
struct LaunchTerm {
  int64_t slot; // of the argument
  int64_t bits;
  int64_t factor;

  int64_t getArgument(const uint64_t *slots) const {
    return signExtend(slots[slot], bits);
  }
  bool operator==(const LaunchTerm &other) const {
    return slot == other.slot && bits == other.bits && factor == other.factor;
  }
};

/// An index that is the same in all iterations of a launch: a constant plus
/// multiples of integer arguments.
struct FixedIndex {
  int64_t dimension;
  int64_t constant;
  std::vector<LaunchTerm> terms;
  /// The program computes the sum in integers of this many bits, which wrap:
  /// the sum counts modulo 2^bits.
  int64_t bits = 64;

  int64_t evaluate(const uint64_t *args) const {
    // The sum is computed in unsigned numbers, and wraps to `bits` bits as it
    // does in the program.
    uint64_t sum = static_cast<uint64_t>(constant);
    for (const LaunchTerm &term : terms)
      sum += static_cast<uint64_t>(term.getArgument(args)) *
             static_cast<uint64_t>(term.factor);
    return signExtend(sum, bits);
  }
  bool operator==(const FixedIndex &other) const {
    return dimension == other.dimension && constant == other.constant &&
           terms == other.terms && bits == other.bits;
  }
  /// True if the two indices certainly differ in each launch.
  bool isApart(const FixedIndex &other) const {
    uint64_t difference =
        static_cast<uint64_t>(constant) - static_cast<uint64_t>(other.constant);
    return dimension == other.dimension && terms == other.terms &&
           signExtend(difference, std::min(bits, other.bits)) != 0;
  }
};

/// Elements that a launch certainly stores: along each dimension the half-open
/// range [lower, upper), if none of the ranges `loops` is empty.
struct StoredBox {
  struct Range {
    FixedIndex lower, upper;
  };
  std::vector<Range> ranges, loops;
};

} // namespace mlir::tai::runtime

#endif // TAI_ABI_LAUNCHACCESSES_H
