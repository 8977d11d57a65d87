//===- FillRun.h - Fills that follow one another ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Fills with nothing in between are given to the device together, and it does
// them in any order. So none may overlap another that fills with other bytes:
// what a later one fills again is taken from the earlier one here.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_FILLRUN_H
#define TAI_LIB_RUNTIME_QUEUE_FILLRUN_H

#include "tai/Runtime/Device/Device.h"

namespace mlir::tai::runtime {

/// The pattern of a fill again and again, to eight bytes.
uint64_t repeatPattern(const void *pattern, int patternBytes);

/// A fill of so many bytes or more is by itself: the driver and a kernel write
/// them as fast as memory takes them, in more than ten microseconds on an H200.
int64_t largeFillBytes();

/// Whether the rows have nothing in between.
bool isDense(const DeviceRows &rows);

/// Whether the pattern consists of one byte again and again.
bool isUniform(uint64_t pattern);

/// Whether the two may change places.
bool canChangePlaces(const DeviceFill &a, const DeviceFill &b);

/// Whether all that `earlier` fills is filled by `later`, too.
bool isFilledAgain(const DeviceFill &earlier, const DeviceFill &later);

class FillRun {
public:
  /// Adds one behind the others. False where it must come after them.
  bool add(const DeviceFill &fill);
  const std::vector<DeviceFill> &get() const { return fills; }
  void clear() { fills.clear(); }

private:
  std::vector<DeviceFill> fills;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_FILLRUN_H
