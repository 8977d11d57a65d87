//===- CudaFills.cpp - Memory of a GPU that is filled ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A fill by the driver takes a microsecond, however small it is, and what comes
// next is made ready only when it is done. Several are one kernel, which can
// overlap as others do (see FillTable.h). A large one is by itself: there is
// nothing to gain.
//
//===----------------------------------------------------------------------===//

#include "../Queue/FillRun.h"
#include "CudaDevice.h"
#include "FillTable.h"
#include <algorithm>
#include <cstdio>
#include <cstring>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::cuda;

static int64_t bytesOf(const DeviceRows &rows) {
  return rows.rowBytes * rows.rows * rows.outer;
}

static bool isDense(const DeviceRows &rows) {
  return rows.rows == 1 && rows.outer == 1;
}

//===----------------------------------------------------------------------===//
// By the driver
//===----------------------------------------------------------------------===//

Status CudaDevice::fill(DevicePtr to, const void *pattern, int patternBytes,
                        int64_t count) {
  Status status = enter();
  if (!status || count <= 0)
    return status;
  isAfterKernel = false;
  auto size = static_cast<size_t>(count);
  char what[96];
  std::snprintf(what, sizeof what,
                "%lld elements of %d bytes at %#llx cannot be filled",
                static_cast<long long>(count), patternBytes,
                static_cast<unsigned long long>(to));
  auto *bytes = static_cast<const char *>(pattern);
  bool zero =
      std::all_of(bytes, bytes + patternBytes, [](char b) { return !b; });
  if (zero || patternBytes == 1)
    return check(cu.memsetD8Async(to, static_cast<unsigned char>(bytes[0]),
                                  size * static_cast<size_t>(patternBytes),
                                  stream),
                 what);
  if (patternBytes == 2) {
    unsigned short value;
    std::memcpy(&value, pattern, sizeof(value));
    return check(cu.memsetD16Async(to, value, size, stream), what);
  }
  unsigned words[2] = {};
  std::memcpy(words, pattern, static_cast<size_t>(patternBytes));
  if (patternBytes == 4 || words[0] == words[1])
    return check(cu.memsetD32Async(to, words[0],
                                   size * static_cast<size_t>(patternBytes / 4),
                                   stream),
                 what);
  return fillByKernel({{to, 0, 8 * count, 1}, repeatPattern(pattern, 8), 8});
}

Status CudaDevice::fillRows(const DeviceRows &to, const void *pattern,
                            int patternBytes) {
  return fillByKernel({to, repeatPattern(pattern, patternBytes), patternBytes});
}

//===----------------------------------------------------------------------===//
// By a kernel
//===----------------------------------------------------------------------===//

Status CudaDevice::runFills(TaiFillTable &table) {
  if (table.count == 0)
    return Status::success();
  LaunchShape shape;
  shape.threads = taiFillThreads;
  shape.blocks = static_cast<unsigned>(
      std::min<uint64_t>(table.entries[table.count - 1].end,
                         isFillingAside ? most.multiprocessors : fillBlocks));
  shape.overlaps = doesOverlap();
  // One parameter, of all these words.
  constexpr size_t words = sizeof(table) / sizeof(uint64_t);
  uint64_t slots[words];
  std::memcpy(slots, &table, sizeof(table));
  table = TaiFillTable();
  return launch(*fillFunction, shape, slots, words);
}

/// Adds it, or both halves of what is too much for an entry. What is in the
/// table is queued where there is no room left.
Status CudaDevice::addFill(TaiFillTable &table, const DeviceFill &fill) {
  const DeviceRows &rows = fill.rows;
  if (bytesOf(rows) <= 0)
    return Status::success();
  if (!isDense(rows) &&
      static_cast<uint64_t>(bytesOf(rows)) >= taiFillMostBytes) {
    DeviceFill first = fill, second = fill;
    bool isOuter = rows.outer > 1;
    int64_t half = (isOuter ? rows.outer : rows.rows) / 2;
    (isOuter ? first.rows.outer : first.rows.rows) = half;
    (isOuter ? second.rows.outer : second.rows.rows) -= half;
    second.rows.address +=
        static_cast<uint64_t>(half * (isOuter ? rows.outerStep : rows.step));
    Status status = addFill(table, first);
    return status ? addFill(table, second) : std::move(status);
  }
  Status status;
  if (table.count == taiFillEntries)
    status = runFills(table);
  auto number = [](int64_t value) { return static_cast<uint64_t>(value); };
  taiFillAdd(&table, rows.address, number(rows.step), number(rows.rowBytes),
             number(rows.rows), number(rows.outerStep), number(rows.outer),
             fill.pattern);
  return status;
}

Status CudaDevice::fillByKernel(const DeviceFill &fill) {
  TaiFillTable table = {};
  Status status = addFill(table, fill);
  return status ? runFills(table) : std::move(status);
}

Status CudaDevice::fillAlone(const DeviceFill &fill) {
  const DeviceRows &rows = fill.rows;
  bool byKernel =
      (doesOverlap() || isFillingAside) && bytesOf(rows) < largeFillBytes();
  return isDense(rows) && !byKernel && !fill.isJoined
             ? this->fill(rows.address, &fill.pattern, fill.patternBytes,
                          rows.rowBytes / fill.patternBytes)
             : fillByKernel(fill);
}

Status CudaDevice::fillAll(const std::vector<DeviceFill> &fills) {
  if (fills.size() == 1)
    return fillAlone(fills.front());
  // The others come last: what follows is made ready while they run.
  Status status;
  int64_t large = largeFillBytes();
  std::vector<const DeviceFill *> together;
  for (const DeviceFill &fill : fills)
    if (bytesOf(fill.rows) < large)
      together.push_back(&fill);
    else if (status)
      status = fillAlone(fill);
  if (status && together.size() == 1)
    return fillAlone(*together.front());
  TaiFillTable table = {};
  for (const DeviceFill *fill : together)
    if (status)
      status = addFill(table, *fill);
  return status ? runFills(table) : std::move(status);
}

//===----------------------------------------------------------------------===//
// Beside other work
//===----------------------------------------------------------------------===//

/// In a branch of the graph: what another stream is given while this one is
/// recorded. A block on each multiprocessor leaves room for the launches.
Status CudaDevice::fillAside(const std::vector<DeviceFill> &fills) {
  if (!side || !isCapturing || isAside)
    return fillAll(fills);
  Status status = order(stream, side);
  if (!status)
    return status;
  bool wasAfterKernel = isAfterKernel, overlapped = capturesOverlaps;
  isAside = isFillingAside = true;
  capturesOverlaps = false;
  std::swap(stream, side);
  status = fillAll(fills);
  std::swap(stream, side);
  capturesOverlaps = overlapped;
  isAfterKernel = wasAfterKernel;
  isFillingAside = false;
  return status;
}

/// What comes next does not wait for one kernel alone, so it waits for the end
/// of both.
Status CudaDevice::joinAside() {
  if (!isAside)
    return Status::success();
  isAside = isAfterKernel = false;
  return order(side, stream);
}
