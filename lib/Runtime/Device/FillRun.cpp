//===- FillRun.cpp - Consecutive fills ------------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Device/FillRun.h"
#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <numeric>

using namespace mlir::tai::runtime;

uint64_t mlir::tai::runtime::repeatPattern(const void *pattern,
                                           int patternBytes) {
  uint64_t word = 0;
  for (int at = 0; at < 8; at += patternBytes)
    std::memcpy(reinterpret_cast<char *>(&word) + at, pattern,
                static_cast<size_t>(patternBytes));
  return word;
}

int64_t mlir::tai::runtime::largeFillBytes() {
  const char *given = std::getenv("TAI_FILLS_TOGETHER_BYTES");
  return given && *given ? std::strtoll(given, nullptr, 10) : int64_t(64) << 20;
}

//===----------------------------------------------------------------------===//
// Two fills
//===----------------------------------------------------------------------===//

bool mlir::tai::runtime::isDense(const DeviceRows &rows) {
  return rows.rows == 1 && rows.outer == 1;
}

/// The address after the last byte of strided rows.
static uint64_t endOf(const DeviceRows &rows) {
  return rows.address +
         static_cast<uint64_t>((rows.outer - 1) * rows.outerStep +
                               (rows.rows - 1) * rows.step + rows.rowBytes);
}

/// Returns the distance of which the starts of all rows are multiples, counted
/// from the first row; 0 for a single row.
static int64_t pitchOf(const DeviceRows &rows) {
  return std::gcd(rows.rows > 1 ? rows.step : 0,
                  rows.outer > 1 ? rows.outerStep : 0);
}

/// True only if two sets of strided rows have no byte in common.
static bool areApart(const DeviceRows &a, const DeviceRows &b) {
  if (endOf(a) <= b.address || endOf(b) <= a.address)
    return true;
  // The rows of fields that share cells are interleaved: their address ranges
  // overlap, but their bytes do not.
  int64_t pitch = std::gcd(pitchOf(a), pitchOf(b));
  if (pitch == 0)
    return false;
  int64_t distance = static_cast<int64_t>(b.address - a.address) % pitch;
  if (distance < 0)
    distance += pitch;
  return distance >= a.rowBytes && distance + b.rowBytes <= pitch;
}

bool mlir::tai::runtime::isUniform(uint64_t pattern) {
  return pattern == (pattern & 0xff) * 0x0101010101010101;
}

bool mlir::tai::runtime::canChangePlaces(const DeviceFill &a,
                                         const DeviceFill &b) {
  return (a.pattern == b.pattern && isUniform(a.pattern)) ||
         areApart(a.rows, b.rows);
}

bool mlir::tai::runtime::isFilledAgain(const DeviceFill &earlier,
                                       const DeviceFill &later) {
  return isDense(later.rows) && later.rows.address <= earlier.rows.address &&
         endOf(earlier.rows) <= endOf(later.rows);
}

//===----------------------------------------------------------------------===//
// Adjacent fills
//===----------------------------------------------------------------------===//

bool FillRun::add(const DeviceFill &fill) {
  // The number of pending fills is limited, since each new fill is compared
  // with all of them.
  constexpr size_t most = 64;
  if (fills.size() >= most)
    return false;
  std::vector<DeviceFill> kept;
  kept.reserve(fills.size() + 2);
  for (const DeviceFill &before : fills) {
    if (isFilledAgain(before, fill))
      continue;
    if (canChangePlaces(before, fill)) {
      kept.push_back(before);
      continue;
    }
    if (!isDense(before.rows) || !isDense(fill.rows))
      return false;
    // If both cuts lie between repetitions of the pattern, the parts of the
    // earlier fill before and after the new fill are kept.
    uint64_t begin = before.rows.address, end = endOf(before.rows);
    uint64_t from = std::max(begin, fill.rows.address);
    uint64_t to = std::min(end, endOf(fill.rows));
    auto size = static_cast<uint64_t>(before.patternBytes);
    if ((from - begin) % size != 0 || (to - begin) % size != 0)
      return false;
    for (auto [first, last] : {std::pair(begin, from), std::pair(to, end)})
      if (first < last) {
        DeviceFill part = before;
        part.rows = {first, 0, static_cast<int64_t>(last - first), 1};
        kept.push_back(part);
      }
  }
  fills = std::move(kept);
  fills.push_back(fill);
  return true;
}

//===----------------------------------------------------------------------===//
// Default implementations
//===----------------------------------------------------------------------===//

/// The default implementation runs the fills in reverse, to expose callers that
/// rely on their order.
Status Device::fillAll(const std::vector<DeviceFill> &fills) {
  Status status;
  for (auto fill = fills.rbegin(); status && fill != fills.rend(); ++fill)
    status = fillRows(fill->rows, &fill->pattern, fill->patternBytes);
  return status;
}

Status Device::fillAside(const std::vector<DeviceFill> &fills) {
  return fillAll(fills);
}
Status Device::joinAside() { return Status::success(); }
