//===- DeviceReport.h - Failures and output of device code ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Reads on the host what device code has left in the state of its device. The
// use of it: copy a fresh state to the device; after waiting, copy the state
// back, then as many bytes of output as it says it has, read both, and, if
// anything was there, copy a fresh state again.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_DEVICE_DEVICEREPORT_H
#define TAI_RUNTIME_DEVICE_DEVICEREPORT_H

#include "tai/ABI/DeviceState.h"
#include "tai/Support/Status.h"
#include <string>
#include <vector>

namespace mlir::tai::runtime {

/// A state in which nothing has happened, with room for so many bytes of output
/// behind it (a multiple of eight).
TaiDeviceState freshDeviceState(uint64_t outputCapacity, uint64_t stackLimit);

/// Whether anything has happened.
inline bool hasDeviceReport(const TaiDeviceState &state) {
  return state.failed || state.outputUsed || state.lostLines || state.stopped;
}

/// How many of the bytes behind the state hold records.
uint64_t deviceOutputBytes(const TaiDeviceState &state);

struct DeviceReport {
  /// The first failure, in the words that the CPU has for it.
  Status failure;
  /// What was printed, in order, without the newlines.
  std::vector<std::string> lines;
  /// Lines that found no room.
  uint64_t lostLines = 0;
  /// The number of the thread that has interrupted a kernel, or 0.
  uint32_t stoppedBy = 0;
};

/// Reads the state and the `bytes` bytes of output behind it. Fails where they
/// are not what device code writes: something wrote over them.
Status readDeviceReport(const TaiDeviceState &state, const void *output,
                        uint64_t bytes, DeviceReport &report);

/// What to say where device code has used memory that is none of its own, and
/// how to find it. `evidence` is what was seen.
Status deviceWentOutOfRange(const std::string &evidence);

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_DEVICE_DEVICEREPORT_H
