//===- DeviceLaunches.h - Kernels that run on a device ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The steps around the call of a kernel's code: device code is loaded at the
// first launch, trees are made current on the device, and failures are
// collected.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_DEVICELAUNCHES_H
#define TAI_RUNTIME_LAUNCH_DEVICELAUNCHES_H

#include "tai/Runtime/Device/KeptChoices.h"
#include "tai/Runtime/Launch/Kernel.h"
#include "tai/Runtime/Launch/Options.h"
#include "tai/Runtime/Mirror/DeviceHost.h"

namespace mlir::tai::runtime {

struct Launch;

class DeviceLaunches {
public:
  DeviceLaunches(DeviceHost &devices, const Options &options)
      : devices(devices), options(options) {}

  /// Sets the storage for chosen block sizes, for kernels loaded afterwards.
  void keepBlockSizes(KeptChoices kept) { blockSizes = std::move(kept); }

  /// `enter` must be called before the code of a kernel runs, and `leave` after
  /// it.
  Status enter(Launch &launch, Kernel &kernel);
  void leave(Launch &launch);

private:
  Status load(Kernel &kernel, uint64_t epoch);

  DeviceHost &devices;
  const Options &options;
  KeptChoices blockSizes;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_DEVICELAUNCHES_H
