//===- DeviceAccesses.h - Accesses of a device function ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The bytes that each device function reads and writes, in terms of its
// parameters, as the compiler found them: the accesses of a launch follow from
// its parameter slots alone, so that launches on different rows of a field are
// independent. The accesses are also given by iteration, so that launches in
// which each thread accesses its own elements need no barrier between them. See
// docs/decisions/0012-fused-launches.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ABI_DEVICEACCESSES_H
#define TAI_ABI_DEVICEACCESSES_H

#include "tai/ABI/LaunchAccesses.h"
#include <cstdint>
#include <optional>
#include <vector>

namespace mlir::tai::runtime {

/// The maximum of threads in a block, on any GPU.
constexpr unsigned kMostBlockThreads = 1024;

/// An LLVM function attribute of a device function with less than two warps of
/// iterations, whose float additions are therefore not combined.
inline constexpr char kFewIterationsAttrName[] = "tai.few_iterations";

/// The accesses of one operation of a device function. Iteration (i0, i1, ...)
/// touches bytes of
///   address(slot) + offset + sum of terms + sum of strides * i
/// and `window` bytes from there on. Inside of the window its accesses are
/// `step` bytes apart, as are all elements of this operation over all
/// iterations, and have `size` bytes; a step of 0 means a single element.
struct DeviceAccess {
  enum Kind : int64_t {
    Read,
    Write,
    /// An atomic addition whose result is unused: such additions commute. In
    /// deterministic mode, additions of floats count as writes instead.
    Sum,
  };
  int64_t kind = Write;
  int64_t slot = 0;
  int64_t offset = 0;
  int64_t window = 0;
  int64_t step = 0;
  int64_t size = 0;
  /// Non-zero where the program computes indices in 32 bits: the access then
  /// holds as long as offset, terms and strides together stay far below 2^31
  /// times `unit` bytes.
  int64_t unit = 0;
  /// For each dimension of the loop: the distance in bytes between the memory
  /// accesses of consecutive iterations.
  std::vector<int64_t> strides;
  std::vector<LaunchTerm> terms;

  bool operator==(const DeviceAccess &other) const {
    return kind == other.kind && slot == other.slot && offset == other.offset &&
           window == other.window && step == other.step && size == other.size &&
           unit == other.unit && strides == other.strides &&
           terms == other.terms;
  }
};

/// Functions that can run in tiles have a variant that runs one iteration of
/// the loop. tileSuffix: the suffix of the variant's name. tileSiteFunction: a
/// function that the variant calls with an address and the number of a site,
/// and that returns the address to access instead.
constexpr char tileSuffix[] = "_tile";
constexpr char tileSiteFunction[] = "tai_tile_site";

/// One load or store in the body of a loop. Sites of functions that can run in
/// tiles are numbered; see ProgramTiles.h.
struct TileSite {
  /// Along one dimension of the loop: iteration i touches cell number i + shift
  /// of `extent` cells that lie `stride` bytes apart; with `wraps`, cell number
  /// i + shift modulo the extent. With a stride of 0, all iterations touch one
  /// cell.
  struct Digit {
    int64_t stride = 0, extent = 0, shift = 0;
    bool wraps = false;
    bool operator==(const Digit &other) const {
      return stride == other.stride && extent == other.extent &&
             shift == other.shift && wraps == other.wraps;
    }
  };
  /// The access. If `isRegular`, its offset and terms give the address of cell
  /// 0, and its strides are zero.
  DeviceAccess access;
  /// True if the index digits (parts of the index, one for each level of the
  /// layout) in `digits` give the cell that an iteration touches; if false,
  /// only the bytes in `access` are known.
  bool isRegular = false;
  /// True if every iteration executes this load or store exactly once.
  bool isCertain = false;
  std::vector<Digit> digits;

  bool operator==(const TileSite &other) const {
    return access == other.access && isRegular == other.isRegular &&
           isCertain == other.isCertain && digits == other.digits;
  }
};

/// All memory accesses of a device function. Exists only if all accesses of the
/// function are known.
struct FunctionAccesses {
  /// Iterations are distributed with the stride of the grid: iteration number
  /// i, counted over all dimensions with the last one fastest, is executed by
  /// thread i modulo the threads of the grid.
  bool isGridStride = false;
  /// The number of iterations along each dimension of the loop; -1 if unknown.
  std::vector<int64_t> extents;
  std::vector<DeviceAccess> accesses;

  /// Lower bounds of the loop, and its loads and stores. Empty if the device
  /// function cannot run in tiles; otherwise there is a variant of the function
  /// that runs one iteration, with an additional parameter for each dimension.
  std::vector<int64_t> lower;
  std::vector<TileSite> sites;

  /// The accesses as a list of numbers, which is stored with the code.
  std::vector<int64_t> encode() const {
    std::vector<int64_t> words{isGridStride,
                               static_cast<int64_t>(extents.size())};
    words.insert(words.end(), extents.begin(), extents.end());
    for (const DeviceAccess &access : accesses)
      encode(access, words);
    if (!sites.empty()) {
      words.push_back(sitesFollow);
      std::vector<int64_t> rest = encodeSites();
      words.insert(words.end(), rest.begin(), rest.end());
    }
    return words;
  }

  /// Encodes the loads and stores of the loop, the part of the list that
  /// follows the word `sitesFollow`.
  std::vector<int64_t> encodeSites() const {
    std::vector<int64_t> words = lower;
    for (const TileSite &site : sites) {
      encode(site.access, words);
      words.push_back(site.isRegular);
      words.push_back(site.isCertain);
      for (const TileSite::Digit &digit : site.digits)
        for (int64_t word :
             {digit.stride, digit.extent, digit.shift, int64_t(digit.wraps)})
          words.push_back(word);
    }
    return words;
  }
  static constexpr int64_t sitesFollow = -1;

  /// Decodes the list of numbers. No value for an empty list, and for a list
  /// that `encode` cannot have made.
  static std::optional<FunctionAccesses>
  decode(const std::vector<int64_t> &words) {
    size_t at = 0;
    auto has = [&](int64_t count) {
      return count >= 0 && static_cast<uint64_t>(count) <= words.size() - at;
    };
    if (!has(2))
      return std::nullopt;
    FunctionAccesses result;
    result.isGridStride = words[at++] != 0;
    int64_t rank = words[at++];
    if (!has(rank))
      return std::nullopt;
    for (int64_t d = 0; d < rank; ++d)
      result.extents.push_back(words[at++]);
    while (at < words.size() && words[at] != sitesFollow) {
      DeviceAccess access;
      if (!decode(words, at, rank, access))
        return std::nullopt;
      result.accesses.push_back(std::move(access));
    }
    if (at == words.size())
      return result;
    ++at;
    if (!has(rank))
      return std::nullopt;
    for (int64_t d = 0; d < rank; ++d)
      result.lower.push_back(words[at++]);
    while (at < words.size()) {
      TileSite site;
      if (!decode(words, at, rank, site.access) || !has(2 + 4 * rank))
        return std::nullopt;
      site.isRegular = words[at++] != 0;
      site.isCertain = words[at++] != 0;
      for (int64_t d = 0; d < rank; ++d, at += 4)
        site.digits.push_back(
            {words[at], words[at + 1], words[at + 2], words[at + 3] != 0});
      result.sites.push_back(std::move(site));
    }
    return result;
  }

private:
  static void encode(const DeviceAccess &access, std::vector<int64_t> &words) {
    for (int64_t word : {access.kind, access.slot, access.offset, access.window,
                         access.step, access.size, access.unit})
      words.push_back(word);
    words.insert(words.end(), access.strides.begin(), access.strides.end());
    words.push_back(static_cast<int64_t>(access.terms.size()));
    for (const LaunchTerm &term : access.terms)
      for (int64_t word : {term.slot, term.bits, term.factor})
        words.push_back(word);
  }

  static bool decode(const std::vector<int64_t> &words, size_t &at,
                     int64_t rank, DeviceAccess &access) {
    auto left = static_cast<int64_t>(words.size() - at);
    if (left < 8 + rank)
      return false;
    for (int64_t *word :
         {&access.kind, &access.slot, &access.offset, &access.window,
          &access.step, &access.size, &access.unit})
      *word = words[at++];
    for (int64_t d = 0; d < rank; ++d)
      access.strides.push_back(words[at++]);
    int64_t terms = words[at++];
    left -= 8 + rank;
    if (terms < 0 || terms > left / 3)
      return false;
    for (; terms > 0; --terms, at += 3)
      access.terms.push_back({words[at], words[at + 1], words[at + 2]});
    return true;
  }
};

} // namespace mlir::tai::runtime

#endif // TAI_ABI_DEVICEACCESSES_H
