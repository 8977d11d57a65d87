//===- FillRun.h - Consecutive fills ----------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Consecutive fills are passed to the device together, and run in any order. So
// none may overlap another with different bytes: a part that a later fill
// overwrites is removed from the earlier one here.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_DEVICE_FILLRUN_H
#define TAI_RUNTIME_DEVICE_FILLRUN_H

#include "tai/Runtime/Device/Device.h"

namespace mlir::tai::runtime {

/// Repeats the pattern of a fill until it has eight bytes.
uint64_t repeatPattern(const void *pattern, int patternBytes);

/// Fills of this size or more are not merged: limited by memory bandwidth, each
/// takes more than ten microseconds on an H200 anyway.
int64_t largeFillBytes();

/// True if strided rows of memory are contiguous.
bool isDense(const DeviceRows &rows);

/// True if all bytes of a fill pattern are the same.
bool isUniform(uint64_t pattern);

/// True if two fills may run in either order.
bool canChangePlaces(const DeviceFill &a, const DeviceFill &b);

/// True if the fill `later` overwrites all bytes of the fill `earlier`.
bool isFilledAgain(const DeviceFill &earlier, const DeviceFill &later);

class FillRun {
public:
  /// Adds a fill to the run of fills that are queued together. False if the
  /// fill must run after them.
  bool add(const DeviceFill &fill);
  const std::vector<DeviceFill> &get() const { return fills; }
  void clear() { fills.clear(); }

private:
  std::vector<DeviceFill> fills;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_DEVICE_FILLRUN_H
