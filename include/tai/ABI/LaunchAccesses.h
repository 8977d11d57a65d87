//===- LaunchAccesses.h - Elements that a launch accesses -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The elements that a kernel accesses, in terms of its arguments, as the
// compiler found them; the runtime evaluates that for the arguments of a
// launch.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ABI_LAUNCHACCESSES_H
#define TAI_ABI_LAUNCHACCESSES_H

#include <cstdint>
#include <vector>

namespace mlir::tai::runtime {

enum class AccessKind : uint8_t { Read, Write, Accumulate };

/// An index that is the same in all iterations of a launch: a constant plus
/// multiples of integer arguments.
struct FixedIndex {
  struct Term {
    int64_t slot; // of the argument
    unsigned bits;
    int64_t factor;

    bool operator==(const Term &other) const {
      return slot == other.slot && bits == other.bits && factor == other.factor;
    }
  };
  int64_t dimension;
  int64_t constant;
  std::vector<Term> terms;

  int64_t evaluate(const uint64_t *args) const {
    // Wraps where the arguments do.
    uint64_t sum = static_cast<uint64_t>(constant);
    for (const Term &term : terms) {
      unsigned unused = 64 - term.bits;
      auto value = static_cast<int64_t>(args[term.slot] << unused) >> unused;
      sum += static_cast<uint64_t>(value) * static_cast<uint64_t>(term.factor);
    }
    return static_cast<int64_t>(sum);
  }
  bool operator==(const FixedIndex &other) const {
    return dimension == other.dimension && constant == other.constant &&
           terms == other.terms;
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
