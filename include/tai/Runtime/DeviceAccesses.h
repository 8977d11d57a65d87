//===- DeviceAccesses.h - What a device function touches --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The compiler says of each device function which bytes it reads and writes, in
// terms of its parameters: those of a launch are then known from its slots
// alone, and launches that touch different rows of a field are told apart. It
// also says which iteration touches what, so that launches in which each
// thread goes on with its own elements need not wait for each other. See
// docs/decisions/0012-fused-launches.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_DEVICEACCESSES_H
#define TAI_RUNTIME_DEVICEACCESSES_H

#include <cstdint>
#include <optional>
#include <vector>

namespace mlir::tai::runtime {

/// The accesses of one operation of a device function. Iteration (i0, i1, ...)
/// touches bytes of
///   address(slot) + offset + sum of terms + sum of strides * i
/// and `window` bytes from there on. Inside of the window its accesses are
/// `step` bytes apart, as are all elements of this operation over all
/// iterations, and have `size` bytes; a step of 0 says that there is one
/// element only.
struct DeviceAccess {
  enum Kind : int64_t {
    Read,
    Write,
    /// An atomic addition whose result nobody uses. Additions may change
    /// places; in deterministic mode those of floats are no sums but writes.
    Sum,
  };
  /// An integer parameter, sign-extended from so many bits, times a factor.
  struct Term {
    int64_t slot;
    int64_t bits;
    int64_t factor;
    bool operator==(const Term &other) const {
      return slot == other.slot && bits == other.bits && factor == other.factor;
    }
  };

  int64_t kind = Write;
  int64_t slot = 0;
  int64_t offset = 0;
  int64_t window = 0;
  int64_t step = 0;
  int64_t size = 0;
  /// Not 0 where the program multiplies in 32 bits: then all of this holds as
  /// long as offset, terms and strides together stay far below 2^31 times so
  /// many bytes.
  int64_t unit = 0;
  /// One for each dimension of the loop.
  std::vector<int64_t> strides;
  std::vector<Term> terms;

  bool operator==(const DeviceAccess &other) const {
    return kind == other.kind && slot == other.slot && offset == other.offset &&
           window == other.window && step == other.step && size == other.size &&
           unit == other.unit && strides == other.strides &&
           terms == other.terms;
  }
};

/// All accesses of a device function: what is not listed it does not touch. A
/// function of which this cannot be said has none of these.
struct FunctionAccesses {
  /// Iteration number i, counted over all dimensions with the last one running
  /// fastest, is of thread i modulo the threads of the grid.
  bool isPlain = false;
  /// Of the loop; -1 for what is not known.
  std::vector<int64_t> extents;
  std::vector<DeviceAccess> accesses;

  /// As a list of numbers, to be kept with the code.
  std::vector<int64_t> encode() const {
    std::vector<int64_t> words{isPlain, static_cast<int64_t>(extents.size())};
    words.insert(words.end(), extents.begin(), extents.end());
    for (const DeviceAccess &access : accesses) {
      for (int64_t word :
           {access.kind, access.slot, access.offset, access.window, access.step,
            access.size, access.unit})
        words.push_back(word);
      words.insert(words.end(), access.strides.begin(), access.strides.end());
      words.push_back(static_cast<int64_t>(access.terms.size()));
      for (const DeviceAccess::Term &term : access.terms)
        for (int64_t word : {term.slot, term.bits, term.factor})
          words.push_back(word);
    }
    return words;
  }

  /// Nothing for an empty list, and for what no list of these is.
  static std::optional<FunctionAccesses>
  decode(const std::vector<int64_t> &words) {
    size_t at = 0;
    auto has = [&](int64_t count) {
      return count >= 0 && static_cast<uint64_t>(count) <= words.size() - at;
    };
    if (!has(2))
      return std::nullopt;
    FunctionAccesses result;
    result.isPlain = words[at++] != 0;
    int64_t rank = words[at++];
    if (!has(rank))
      return std::nullopt;
    for (int64_t d = 0; d < rank; ++d)
      result.extents.push_back(words[at++]);
    while (at < words.size()) {
      if (!has(8 + rank))
        return std::nullopt;
      DeviceAccess access;
      for (int64_t *word :
           {&access.kind, &access.slot, &access.offset, &access.window,
            &access.step, &access.size, &access.unit})
        *word = words[at++];
      for (int64_t d = 0; d < rank; ++d)
        access.strides.push_back(words[at++]);
      int64_t terms = words[at++];
      if (terms > static_cast<int64_t>(words.size()) || !has(3 * terms))
        return std::nullopt;
      for (; terms > 0; --terms, at += 3)
        access.terms.push_back({words[at], words[at + 1], words[at + 2]});
      result.accesses.push_back(std::move(access));
    }
    return result;
  }
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_DEVICEACCESSES_H
