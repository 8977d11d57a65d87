//===- ShadowLog.h - What shadow execution finds ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Shadows of floats in memory, and what `tai-shadow-execution` reports of the
// sites (operations of the source) of a context.
//
// The shadow of a float at an address stands in one table of the process, twice
// as wide: a copy of the float, and how far its shadow lies above it, both in
// its type. A float that differs from the copy was written by somebody who
// knows nothing of shadows (the host, another library, the runtime), and its
// shadow is the float itself: nothing needs to be told. The system provides
// pages of the table as they are used.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_SHADOWLOG_H
#define TAI_RUNTIME_LAUNCH_SHADOWLOG_H

#include "tai/ABI/Abi.h"
#include "tai/Support/Status.h"
#include <atomic>
#include <cstring>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

/// The table, or null where no context asked for it. A symbol of linked code.
extern "C" char *tai_rt_shadows;

namespace mlir::tai::runtime {

/// What was found at one operation of the source. Errors are relative, 1 at the
/// most, of the float to its shadow.
struct ShadowRow {
  std::string operation, kernel;
  std::string place; // "file:line:column", or ""
  int32_t precision; // bits of a number of its type
  int64_t lost;      // results of which less than half of the bits are right
  int64_t cancellations; // of them, differences much smaller than the operands
  int64_t flips;         // comparisons and conversions that came out otherwise
  int64_t nonFinite;     // infinite or NaN, where the shadow is finite
  /// The worst of the results, and the error of its operands.
  double errorMade, errorIn;
  /// Of that result; the greatest of all.
  double bitsLost;
};

namespace shadow {

/// Makes the table. Fails where the system refuses the addresses.
Status reserve();

inline char *entryOf(const void *address) {
  auto bits = reinterpret_cast<uintptr_t>(address);
  return tai_rt_shadows + 2 * (bits & TAI_SHADOW_MASK);
}

/// The shadow of a float that has this value now.
template <typename T, typename Wide = long double>
Wide read(const T *address, T value) {
  T entry[2];
  std::memcpy(entry, entryOf(address), sizeof(entry));
  Wide known = value;
  return entry[0] == value ? known + entry[1] : known;
}

template <typename T, typename Wide = long double>
void write(const T *address, T value, Wide exact) {
  T entry[2] = {value, static_cast<T>(exact - value)};
  std::memcpy(entryOf(address), entry, sizeof(entry));
}

/// What lies at these addresses has no shadow any more.
void forget(const void *address, int64_t bytes);

} // namespace shadow

/// The sites of a context.
class ShadowLog {
public:
  struct Site {
    explicit Site(std::string_view text) : text(text) {}
    const std::string text; // operation, kernel and place, with newlines
    int32_t precision = 0;
    std::atomic<int64_t> lost{0}, cancellations{0}, flips{0}, nonFinite{0};
    /// Of the worst result: its error, in parts of that of its operands.
    std::atomic<double> growth{0};
    std::mutex worst;
    double errorMade = 0, errorIn = 0;
  };

  ShadowLog();

  /// The site that compiled code names so. It belongs to one log, as its code
  /// belongs to one context.
  Site &find(TaiShadowSite &named) {
    if (__builtin_expect(
            __atomic_load_n(&named.log, __ATOMIC_ACQUIRE) == identity, true))
      return *static_cast<Site *>(named.site);
    return add(named);
  }
  /// The sites where something was found, those that lost most first.
  std::vector<ShadowRow> rows() const;
  void clear();

private:
  Site &add(TaiShadowSite &named);

  mutable std::mutex mutex;
  std::map<std::string, std::unique_ptr<Site>, std::less<>> sites;
  /// No two logs have one.
  const uint64_t identity;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_SHADOWLOG_H
