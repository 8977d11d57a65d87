//===- ShadowLog.h - Results of shadow execution ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Shadow values of floats in memory, and the findings that code instrumented by
// `tai-shadow-execution` reports for the sites (operations of the source) of a
// context.
//
// The shadow of a float in memory is an entry of one table of the process,
// twice as wide: a copy of the float, and the difference of the shadow to it,
// both in its type. If a float differs from the copy, it was written by code
// that is not instrumented (the host, another library, the runtime), and its
// shadow is the float itself: such code needs no notification. The system
// commits pages of the table on use.
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

/// The table of shadow values, or null if no context has enabled shadow
/// execution. Compiled code refers to this symbol.
extern "C" char *tai_rt_shadows;

namespace mlir::tai::runtime {

/// The findings for one operation of the source. Errors are relative errors of
/// the float to its shadow, at most 1.
struct ShadowRow {
  std::string operation, kernel;
  std::string place;     // "file:line:column", or ""
  int32_t precision;     // bits of a number of its type
  int64_t lost;          // results with less than half of the bits correct
  int64_t cancellations; // of them, differences much smaller than the operands
  int64_t flips; // comparisons and conversions whose result differs from that
                 // of the shadows
  int64_t nonFinite; // infinite or NaN, where the shadow is finite
  /// For the operation's worst result: the relative error of the result, and
  /// the relative error of its operands.
  double errorMade, errorIn;
  /// For the operation's worst result: the number of significant bits lost.
  double bitsLost;
};

namespace shadow {

/// Reserves the table of shadow values. Fails if the system refuses the address
/// range.
Status reserve();

inline char *entryOf(const void *address) {
  auto bits = reinterpret_cast<uintptr_t>(address);
  return tai_rt_shadows + 2 * (bits & TAI_SHADOW_MASK);
}

/// Reads the shadow of the float at `address`, whose current value is `value`.
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

/// Drops the shadow values of a range of addresses.
void forget(const void *address, int64_t bytes);

} // namespace shadow

/// The sites (operations of the source) of a context, with the findings for
/// each.
class ShadowLog {
public:
  struct Site {
    explicit Site(std::string_view text) : text(text) {}
    const std::string text; // operation, kernel and place, with newlines
    int32_t precision = 0;
    std::atomic<int64_t> lost{0}, cancellations{0}, flips{0}, nonFinite{0};
    /// For the operation's worst result: its error divided by the error of its
    /// operands.
    std::atomic<double> growth{0};
    std::mutex worst;
    double errorMade = 0, errorIn = 0;
  };

  ShadowLog();

  /// Finds or makes the site for `named`, a structure in compiled code. This
  /// log must be the log of the context that compiled the code.
  Site &find(TaiShadowSite &named) {
    if (__builtin_expect(
            __atomic_load_n(&named.log, __ATOMIC_ACQUIRE) == identity, true))
      return *static_cast<Site *>(named.site);
    return add(named);
  }
  /// Lists the sites with findings, greatest loss of precision first.
  std::vector<ShadowRow> rows() const;
  void clear();

private:
  Site &add(TaiShadowSite &named);

  mutable std::mutex mutex;
  std::map<std::string, std::unique_ptr<Site>, std::less<>> sites;
  /// Unique among logs.
  const uint64_t identity;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_SHADOWLOG_H
