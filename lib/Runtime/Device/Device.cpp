//===- Device.cpp - Operations that a device may lack ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Default operations, for devices without graphs or events.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Device/Device.h"

using namespace mlir::tai::runtime;

static Status hasNoGraphs() {
  return Status::failure(StatusCode::Internal, "this device has no graphs");
}

Status Device::reserve(int64_t, DevicePtr &) {
  return Status::failure(StatusCode::Internal,
                         "this device does not reserve memory");
}

Status Device::beginCapture(size_t, bool) { return hasNoGraphs(); }
Status Device::endCapture(std::unique_ptr<DeviceGraph> &) {
  return hasNoGraphs();
}
Status Device::run(DeviceGraph &) { return hasNoGraphs(); }
Status Device::change(DeviceGraph &, size_t, DeviceFunction &,
                      const LaunchShape &, const uint64_t *, int) {
  return hasNoGraphs();
}

static Status hasNoEvents() {
  return Status::failure(StatusCode::Internal, "this device has no events");
}

Status Device::record(std::unique_ptr<DeviceEvent> &) { return hasNoEvents(); }
Status Device::wait(DeviceEvent &) { return hasNoEvents(); }
Status Device::elapsed(const DeviceEvent &, const DeviceEvent &, int64_t &) {
  return hasNoEvents();
}

// By default, a device has no other streams, and nothing to wait for.
Status Device::waitForStream(uint64_t) { return Status::success(); }
Status Device::letStreamWait(uint64_t) { return Status::success(); }
