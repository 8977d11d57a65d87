//===- DeviceReport.h - Failures and output of device code ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Decodes on the host the state that code on a device has written
// (TaiDeviceState). Usage: copy a fresh state to the device and run kernels;
// wait for the device, copy back the state and then deviceOutputBytes() of
// output; decode both. If there was a report, copy a fresh state to the device
// again.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_DEVICE_DEVICEREPORT_H
#define TAI_RUNTIME_DEVICE_DEVICEREPORT_H

#include "tai/ABI/DeviceState.h"
#include "tai/Support/Status.h"
#include <string>
#include <vector>

namespace mlir::tai::runtime {

/// The initial state of a device. In device memory, `outputCapacity` bytes of
/// output (a multiple of eight) must follow it.
TaiDeviceState freshDeviceState(uint64_t outputCapacity, uint64_t stackLimit);

/// Whether the state of a device holds a failure, output, or a stop request
/// that the host must report.
inline bool hasDeviceReport(const TaiDeviceState &state) {
  return state.failed || state.outputUsed || state.lostLines || state.stopped;
}

/// The number of bytes of records that follow the state of a device.
uint64_t deviceOutputBytes(const TaiDeviceState &state);

struct DeviceReport {
  /// The first failure of a kernel, with the message that the CPU gives for it.
  Status failure;
  /// The lines that kernels have printed, in order, without newlines.
  std::vector<std::string> lines;
  /// The number of printed lines that were dropped because the buffer was full.
  uint64_t lostLines = 0;
  /// The number of the host thread that asked a kernel to stop, or 0.
  uint32_t stoppedBy = 0;
};

/// Decodes the state and the `bytes` bytes of output that follow it. Fails if
/// the state or the output is corrupt: something has overwritten it.
Status readDeviceReport(const TaiDeviceState &state, const void *output,
                        uint64_t bytes, DeviceReport &report);

/// The failure for out-of-range accesses of device code, with advice on how to
/// find them. `evidence` is the observed error.
Status deviceWentOutOfRange(const std::string &evidence);

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_DEVICE_DEVICEREPORT_H
