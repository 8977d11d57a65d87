//===- AbiShadow.cpp - Entry points for shadow execution ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ABI/Abi.h"
#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Launch/ShadowLog.h"
#include <array>
#include <cmath>
#include <limits>
#include <optional>

using namespace mlir::tai::runtime;

/// The distance of the float `value` from its shadow, `value` + `error`,
/// relative to the shadow; at most 1.
static double relativeError(double value, double error) {
  double exact = value + error;
  if (error == 0)
    return 0;
  double relative = std::abs(error / exact);
  return relative < 1 ? relative : 1;
}

/// Adds `times` to the counter, without a locked operation if only one thread
/// runs (`alone`).
static void count(std::atomic<int64_t> &counter, bool alone,
                  int64_t times = 1) {
  if (alone)
    counter.store(counter.load(std::memory_order_relaxed) + times,
                  std::memory_order_relaxed);
  else
    counter.fetch_add(times, std::memory_order_relaxed);
}

/// The relative error of rounding once to `precision` bits.
static double roundingOf(int32_t precision) {
  return precision == 24 ? 0x1p-24 : std::ldexp(1, -precision);
}

/// The relative error below which a result cannot exceed the site's largest
/// growth of errors. Comparing errors with this bound saves most results a
/// division.
static double reachOf(const ShadowLog::Site &site, double least) {
  return 0.99 * least * site.growth.load(std::memory_order_relaxed);
}

extern "C" void tai_rt_shadow_site(TaiFrame *frame, TaiShadowSite *named,
                                   TaiShadowCounts *counts, int32_t index,
                                   int32_t precision, int32_t fires, double a,
                                   double errorOfA, double b, double errorOfB,
                                   double result, double error, double exact) {
  // If the result in higher precision (`exact`) overflows as well, rounding is
  // not the cause.
  if (!fires || !std::isfinite(exact))
    return;
  Runtime &owner = launchOf(frame).owner();
  ShadowLog::Site &site = owner.shadowLog().find(*named);
  bool alone = owner.threads() == 1;
  if (!std::isfinite(result))
    return count(site.nonFinite, alone);
  count(site.lost, alone);
  // A subtraction counts as a cancellation if both operands are at least eight
  // times as large as the result.
  if (std::min(std::abs(a), std::abs(b)) > 8 * std::abs(result))
    count(site.cancellations, alone);
  double least = roundingOf(precision);
  auto answer = [&] {
    if (!counts)
      return;
    auto *own = reinterpret_cast<TaiShadowCount *>(counts + 1) + index;
    own->reach = reachOf(site, least);
    own->site = &site;
    counts->any = 1;
  };
  if (std::abs(error) < reachOf(site, least) * std::abs(exact))
    return answer();
  double made = relativeError(result, error);
  double in = std::max(relativeError(a, errorOfA), relativeError(b, errorOfB));
  double growth = made / std::max(in, least);
  if (growth > site.growth.load(std::memory_order_relaxed)) {
    std::lock_guard<std::mutex> lock(site.worst);
    if (growth > site.growth.load(std::memory_order_relaxed)) {
      site.growth = growth;
      site.precision = precision;
      site.errorMade = made;
      site.errorIn = in;
    }
  }
  answer();
}

extern "C" void tai_rt_shadow_lanes(TaiFrame *frame, TaiShadowSite *named,
                                    TaiShadowCounts *counts, int32_t index,
                                    int32_t precision, int32_t lanes,
                                    int64_t fires, const double *numbers) {
  for (int32_t lane = 0; lane < lanes; ++lane) {
    auto number = [&](int32_t i) { return numbers[i * lanes + lane]; };
    if (fires >> lane & 1)
      tai_rt_shadow_site(frame, named, counts, index, precision, 1, number(0),
                         number(1), number(2), number(3), number(4), number(5),
                         number(6));
  }
}

extern "C" void tai_rt_shadow_counted(TaiFrame *frame, TaiShadowCounts *counts,
                                      int32_t sites) {
  bool alone = launchOf(frame).owner().threads() == 1;
  auto *own = reinterpret_cast<TaiShadowCount *>(counts + 1);
  for (int32_t i = 0; i < sites; ++i) {
    if (!own[i].lost)
      continue;
    auto &site = *static_cast<ShadowLog::Site *>(own[i].site);
    count(site.lost, alone, own[i].lost);
    count(site.cancellations, alone, own[i].cancellations);
  }
}

extern "C" void tai_rt_shadow_flip(TaiFrame *frame, TaiShadowSite *named,
                                   int32_t precision, double a, double errorOfA,
                                   double b, double errorOfB) {
  double exactA = a + errorOfA, exactB = b + errorOfB;
  if (std::isnan(exactA) || std::isnan(exactB))
    return;
  // A comparison of two values that underflow in the float's type is not
  // counted: their signs are lost.
  double least = precision <= 24 ? 0x1p-126 : 0x1p-1022;
  if (std::abs(exactA) < least && std::abs(exactB) < least)
    return;
  ShadowLog::Site &site = launchOf(frame).owner().shadowLog().find(*named);
  site.flips.fetch_add(1, std::memory_order_relaxed);
  std::lock_guard<std::mutex> lock(site.worst);
  site.precision = precision;
  double in = std::max(relativeError(a, errorOfA), relativeError(b, errorOfB));
  site.errorIn = std::max(site.errorIn, in);
}

extern "C" void tai_rt_shadow_move(TaiFrame *, void *to, const void *from,
                                   int64_t bytes) {
  if (!from)
    return shadow::forget(to, bytes);
  for (int64_t at = 0; at < bytes; at += 4)
    std::memmove(shadow::entryOf(static_cast<char *>(to) + at),
                 shadow::entryOf(static_cast<const char *>(from) + at), 8);
}

//===----------------------------------------------------------------------===//
// Atomic updates
//===----------------------------------------------------------------------===//

namespace {
/// Makes the updates of a float and of its shadow one atomic step. Floats whose
/// addresses select the same flag share a lock.
class UpdateLock {
public:
  explicit UpdateLock(const void *address)
      : flag(flags[(reinterpret_cast<uintptr_t>(address) >> 2) % count]) {
    while (flag.value.test_and_set(std::memory_order_acquire))
      ;
  }
  ~UpdateLock() { flag.value.clear(std::memory_order_release); }

private:
  static constexpr size_t count = 1024;
  struct Flag {
    alignas(64) std::atomic_flag value = ATOMIC_FLAG_INIT;
  };
  static std::array<Flag, count> flags;
  Flag &flag;
};
std::array<UpdateLock::Flag, UpdateLock::count> UpdateLock::flags;
} // namespace

/// Returns NaN if `a` or `b` is NaN, as the instructions for `minimum` and
/// `maximum` do.
template <typename T> static T choose(T a, T b, bool greater) {
  if (std::isnan(a) || std::isnan(b))
    return std::numeric_limits<T>::quiet_NaN();
  return (a < b) == greater ? b : a;
}

/// Returns the value that an update of this kind stores in place of `before`.
template <typename T> static T combine(T before, T operand, int32_t kind) {
  switch (kind) {
  case TAI_SHADOW_ADD:
    return before + operand;
  case TAI_SHADOW_SUB:
    return before - operand;
  case TAI_SHADOW_XCHG:
    return operand;
  default:
    return choose(before, operand, kind == TAI_SHADOW_MAX);
  }
}

/// Applies the operation to the float at `address` and to its shadow, and
/// returns the float's old value. `alone`: no other thread of the launch
/// updates.
template <typename T, typename Exact>
static double update(T *address, int32_t kind, T value, double error,
                     double *oldError, bool alone) {
  std::optional<UpdateLock> lock;
  if (!alone)
    lock.emplace(address);
  T old, result;
  __atomic_load(address, &old, __ATOMIC_RELAXED);
  Exact operand = static_cast<Exact>(value) + static_cast<Exact>(error), before;
  // The update is a compare-and-exchange loop, because other threads may update
  // the element without its shadow.
  do {
    before = shadow::read<T, Exact>(address, old);
    result = combine(old, value, kind);
    if (alone) {
      __atomic_store(address, &result, __ATOMIC_RELAXED);
      break;
    }
  } while (!__atomic_compare_exchange(address, &old, &result, true,
                                      __ATOMIC_RELAXED, __ATOMIC_RELAXED));
  *oldError = static_cast<double>(before - static_cast<Exact>(old));
  shadow::write<T, Exact>(address, result, combine(before, operand, kind));
  return old;
}

extern "C" double tai_rt_shadow_atomic(TaiFrame *frame, void *address,
                                       int32_t kind, int32_t bits, double value,
                                       double error, double *oldError) {
  bool alone = launchOf(frame).owner().threads() == 1;
  if (bits == 32)
    return update<float, double>(static_cast<float *>(address), kind,
                                 static_cast<float>(value), error, oldError,
                                 alone);
  return update<double, long double>(static_cast<double *>(address), kind,
                                     value, error, oldError, alone);
}
