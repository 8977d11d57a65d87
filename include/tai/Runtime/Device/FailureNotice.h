//===- FailureNotice.h - Who hears of failures on a device ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The failure of a kernel on a device is found when the host waits for the
// device, after the launch. Other processes may wait for this one.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_DEVICE_FAILURENOTICE_H
#define TAI_RUNTIME_DEVICE_FAILURENOTICE_H

#include <string>

namespace mlir::tai::runtime {

using FailureNotice = void (*)(const std::string &message);

/// Sets the function of the process that hears of failures on devices; null for
/// none.
void setFailureNotice(FailureNotice notice);
void noticeDeviceFailure(const std::string &message);

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_DEVICE_FAILURENOTICE_H
