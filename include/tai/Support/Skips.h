//===- Skips.h - Names of the work that is skipped --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A skip is work that is left out where a scene does not need it: launches of
// adjoints that are zero, for example. This is the list of skips for the
// runtime, the passes, the tools and the C API. Each skip has a switch and
// counters; results do not depend on the switch. To add a skip or a counter,
// add a line to Skips.def.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_SUPPORT_SKIPS_H
#define TAI_SUPPORT_SKIPS_H

#include <array>
#include <atomic>
#include <cstdint>
#include <string>
#include <string_view>

namespace mlir::tai {

enum class Skip : uint8_t {
#define TAI_SKIP(skip, name, about) skip,
#include "tai/Support/Skips.def"
};

enum class SkipCount : uint8_t {
#define TAI_SKIP_COUNT(skip, counter, name) counter,
#include "tai/Support/Skips.def"
};

struct SkipInfo {
  const char *name;
  const char *about;
};
inline constexpr SkipInfo kSkips[] = {
#define TAI_SKIP(skip, name, about) {name, about},
#include "tai/Support/Skips.def"
};
inline constexpr unsigned kNumSkips = sizeof(kSkips) / sizeof(kSkips[0]);

struct SkipCountInfo {
  Skip skip;
  const char *name;
};
inline constexpr SkipCountInfo kSkipCounts[] = {
#define TAI_SKIP_COUNT(skip, counter, name) {Skip::skip, name},
#include "tai/Support/Skips.def"
};
inline constexpr unsigned kNumSkipCounts =
    sizeof(kSkipCounts) / sizeof(kSkipCounts[0]);

inline constexpr const char *getSkipName(Skip skip) {
  return kSkips[static_cast<unsigned>(skip)].name;
}

/// The set of skips (optimisations that leave out unneeded work) that are on.
class SkipSet {
public:
  static constexpr SkipSet all() { return SkipSet((1u << kNumSkips) - 1); }
  static constexpr SkipSet none() { return SkipSet(0); }
  /// The skips that affect generated code, which passes query.
  static constexpr SkipSet ofCompiler() {
    return SkipSet(bit(Skip::ActivityTests) | bit(Skip::RepeatedLookups) |
                   bit(Skip::InactiveValues) | bit(Skip::UnneededRecords) |
                   bit(Skip::UntakenBranches) | bit(Skip::ZeroAdjoints) |
                   bit(Skip::UnreadZeros));
  }

  constexpr SkipSet() = default;

  constexpr bool has(Skip skip) const { return bits & bit(skip); }
  constexpr void set(Skip skip, bool on) {
    bits = on ? bits | bit(skip) : bits & ~bit(skip);
  }
  constexpr SkipSet operator&(SkipSet other) const {
    return SkipSet(bits & other.bits);
  }
  constexpr bool operator==(SkipSet other) const { return bits == other.bits; }
  constexpr bool operator!=(SkipSet other) const { return bits != other.bits; }

  /// Parses "all", "none", or a list of names separated by commas; "-name"
  /// removes a skip. A list that begins with "-name" starts from all. False,
  /// with a message in `error`, for an unknown name.
  static bool parse(std::string_view text, SkipSet &set, std::string &error) {
    SkipSet result = none();
    bool first = true;
    while (!text.empty()) {
      size_t end = text.find(',');
      std::string_view word = text.substr(0, end);
      text = end == std::string_view::npos ? "" : text.substr(end + 1);
      while (!word.empty() && word.front() == ' ')
        word.remove_prefix(1);
      while (!word.empty() && word.back() == ' ')
        word.remove_suffix(1);
      bool adds = word.empty() || word.front() != '-';
      if (!adds)
        word.remove_prefix(1);
      if (first && !adds)
        result = all();
      first = false;
      SkipSet named = none();
      if (word == "all") {
        named = all();
      } else if (word != "none") {
        unsigned i = 0;
        while (i < kNumSkips && word != kSkips[i].name)
          ++i;
        if (i == kNumSkips) {
          error = "there is no skip '" + std::string(word) +
                  "'; the skips are all, none, " + list(all(), ", ");
          return false;
        }
        named.bits = 1u << i;
      } else if (adds) {
        result = none();
      }
      result.bits = adds ? result.bits | named.bits : result.bits & ~named.bits;
    }
    set = result;
    return true;
  }

  /// The set as text: "all", "none", or the names of the skips.
  std::string str() const {
    if (bits == all().bits)
      return "all";
    return bits ? list(*this, ",") : "none";
  }

private:
  explicit constexpr SkipSet(uint32_t bits) : bits(bits) {}
  static constexpr uint32_t bit(Skip skip) {
    return 1u << static_cast<unsigned>(skip);
  }
  static std::string list(SkipSet set, const char *separator) {
    std::string text;
    for (unsigned i = 0; i < kNumSkips; ++i)
      if (set.bits >> i & 1)
        text += (text.empty() ? "" : separator) + std::string(kSkips[i].name);
    return text;
  }

  uint32_t bits = (1u << kNumSkips) - 1;
};

static_assert(kNumSkips < 32);

/// Amounts, by counter.
using SkipAmounts = std::array<int64_t, kNumSkipCounts>;

/// The counters of skipped work, which any thread may advance.
class SkipCounters {
public:
  void add(SkipCount counter, int64_t amount = 1) {
    slot(counter).fetch_add(amount, std::memory_order_relaxed);
  }
  /// Advances a counter that only one thread at a time updates, by a load and a
  /// store that are not atomic together.
  void bump(SkipCount counter, int64_t amount = 1) {
    std::atomic<int64_t> &value = slot(counter);
    value.store(value.load(std::memory_order_relaxed) + amount,
                std::memory_order_relaxed);
  }
  int64_t get(SkipCount counter) const {
    return values[static_cast<unsigned>(counter)].load(
        std::memory_order_relaxed);
  }
  void add(const SkipAmounts &amounts) {
    for (unsigned i = 0; i < kNumSkipCounts; ++i)
      if (amounts[i])
        values[i].fetch_add(amounts[i], std::memory_order_relaxed);
  }
  void clear() {
    for (std::atomic<int64_t> &value : values)
      value.store(0, std::memory_order_relaxed);
  }

private:
  std::atomic<int64_t> &slot(SkipCount counter) {
    return values[static_cast<unsigned>(counter)];
  }
  std::array<std::atomic<int64_t>, kNumSkipCounts> values{};
};

} // namespace mlir::tai

#endif // TAI_SUPPORT_SKIPS_H
