//===- FillRun.cpp - Fills that follow one another ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "FillRun.h"
#include <algorithm>
#include <cstdlib>
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

static bool isDense(const DeviceRows &rows) {
  return rows.rows == 1 && rows.outer == 1;
}

/// The first byte behind it.
static uint64_t endOf(const DeviceRows &rows) {
  return rows.address +
         static_cast<uint64_t>((rows.outer - 1) * rows.outerStep +
                               (rows.rows - 1) * rows.step + rows.rowBytes);
}

/// All of its rows start at multiples of this behind the first; 0 for one row.
static int64_t pitchOf(const DeviceRows &rows) {
  return std::gcd(rows.rows > 1 ? rows.step : 0,
                  rows.outer > 1 ? rows.outerStep : 0);
}

/// Whether no byte is one of both.
static bool areApart(const DeviceRows &a, const DeviceRows &b) {
  if (endOf(a) <= b.address || endOf(b) <= a.address)
    return true;
  // Those of one lie between those of the other: fields that share cells.
  int64_t pitch = std::gcd(pitchOf(a), pitchOf(b));
  if (pitch == 0)
    return false;
  int64_t distance = static_cast<int64_t>(b.address - a.address) % pitch;
  if (distance < 0)
    distance += pitch;
  return distance >= a.rowBytes && distance + b.rowBytes <= pitch;
}

/// Whether it consists of one byte again and again.
static bool isUniform(uint64_t pattern) {
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
// All that follow one another
//===----------------------------------------------------------------------===//

bool FillRun::add(const DeviceFill &fill) {
  // Each is compared with all others.
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
    // What is left of it, in front of and behind the new one. The pattern goes
    // on behind a whole number of patterns.
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

Status DeviceQueue::StepRunner::run(const Sequence &sequence,
                                    const Step &step) {
  if (!step.isFill()) {
    Status status = finish();
    ++pieces;
    return status ? sequence.run(device, step) : std::move(status);
  }
  DeviceFill fill = sequence.fillOf(step);
  if (fills.add(fill))
    return Status::success();
  Status status = finish();
  (void)fills.add(fill);
  return status;
}

Status DeviceQueue::StepRunner::runAll(const Sequence &sequence) {
  Status status;
  for (const Step &step : sequence.steps)
    if (status)
      status = run(sequence, step);
  return status;
}

Status DeviceQueue::StepRunner::finish() {
  if (fills.get().empty())
    return Status::success();
  Status status = device.fillAll(fills.get());
  ++pieces;
  fills.clear();
  return status;
}

//===----------------------------------------------------------------------===//
// Collecting them
//===----------------------------------------------------------------------===//

/// Whether `second` starts in every place where `first` ends.
static bool isBeside(const DeviceRows &first, const DeviceRows &second) {
  if (second.address != first.address + static_cast<uint64_t>(first.rowBytes) ||
      first.rows != second.rows || first.outer != second.outer)
    return false;
  int64_t bytes = first.rowBytes + second.rowBytes;
  return (first.rows == 1 ||
          (first.step == second.step && bytes <= first.step)) &&
         (first.outer == 1 || (first.outerStep == second.outerStep &&
                               (first.rows > 1 || bytes <= first.outerStep)));
}

/// Rows without anything in between are one, and groups of one row are rows.
static void closeUp(DeviceRows &rows) {
  if (rows.rows > 1 && rows.rowBytes == rows.step) {
    rows.rowBytes *= rows.rows;
    rows.rows = 1;
  }
  if (rows.rows == 1 && rows.outer > 1 && rows.rowBytes == rows.outerStep) {
    rows.rowBytes *= rows.outer;
    rows.outer = 1;
  }
  if (rows.rows == 1) {
    rows.rows = rows.outer;
    rows.step = rows.rows > 1 ? rows.outerStep : 0;
    rows.outer = 1;
  }
  if (rows.outer == 1)
    rows.outerStep = 0;
}

DeviceFill DeviceQueue::Sequence::fillOf(const Step &step) const {
  const uint64_t *values = slots.data() + step.firstSlot;
  // The pattern, and its size behind it.
  const uint64_t *held = values + (step.kind == Step::Kind::Fill ? 1 : 4);
  auto size = static_cast<int>(held[1]);
  DeviceRows rows = rowsOf(step);
  bool isJoined = step.kind == Step::Kind::FillRows && isDense(rows);
  return {rows, repeatPattern(held, size), size, isJoined};
}

void DeviceQueue::Sequence::append(const DeviceFill &fill) {
  const DeviceRows &rows = fill.rows;
  auto size = static_cast<uint64_t>(fill.patternBytes);
  if (isDense(rows) && !fill.isJoined)
    return addWork(Step::Kind::Fill,
                   {rows.address, fill.pattern, size,
                    static_cast<uint64_t>(rows.rowBytes) / size});
  uint64_t bits = 0;
  std::memcpy(&bits, &fill.pattern, size);
  addRows(Step::Kind::FillRows, rows, bits, fill.patternBytes);
}

void DeviceQueue::Sequence::addFill(const DeviceRows &rows, const void *pattern,
                                    int patternBytes) {
  DeviceFill fill{rows, repeatPattern(pattern, patternBytes), patternBytes};
  closeUp(fill.rows);
  // Of the fills that come last: whether each stays, the last one first, and
  // where the new one goes.
  constexpr size_t most = 16;
  bool stays[most];
  size_t first = steps.size(), place = steps.size();
  for (size_t at = steps.size();
       at > 0 && steps.size() - at < most && steps[at - 1].isFill(); --at) {
    DeviceFill before = fillOf(steps[at - 1]);
    if (first == steps.size() && isFilledAgain(fill, before) &&
        isUniform(fill.pattern) && before.pattern == fill.pattern)
      return;
    bool isBefore = false, isBehind = false;
    if (before.pattern == fill.pattern &&
        before.patternBytes == fill.patternBytes) {
      isBefore = isBeside(before.rows, fill.rows);
      isBehind = isBeside(fill.rows, before.rows);
    }
    bool isPart = isBefore || isBehind;
    if (isPart) {
      int64_t bytes = before.rows.rowBytes + fill.rows.rowBytes;
      if (isBefore)
        fill.rows = before.rows;
      fill.rows.rowBytes = bytes;
      fill.isJoined = true;
      closeUp(fill.rows);
      place = at - 1;
    }
    stays[steps.size() - at] = !isPart && !isFilledAgain(before, fill);
    if (!stays[steps.size() - at])
      first = at - 1;
    else if (!canChangePlaces(before, fill))
      break;
  }
  // Those from the first that goes away on are written down anew.
  std::vector<DeviceFill> again;
  for (size_t at = first; at < steps.size(); ++at) {
    if (at == place)
      again.push_back(fill);
    if (stays[steps.size() - 1 - at])
      again.push_back(fillOf(steps[at]));
  }
  if (place == steps.size())
    again.push_back(fill);
  if (first < steps.size()) {
    hash = steps[first].hashBefore;
    slots.resize(steps[first].firstSlot);
    steps.resize(first);
  }
  for (const DeviceFill &each : again)
    append(each);
}

//===----------------------------------------------------------------------===//
// Devices without a way of their own
//===----------------------------------------------------------------------===//

/// The last one first: who counts on their order shall be found out.
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
