//===- RuntimeProfile.cpp - The profiler of a runtime ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// On the CPU a kernel takes the time of its launch. On a device that is the
// time to queue it, which is kept for the trace alone: its loops are timed
// where they run (see DeviceWatch.h).
//
//===----------------------------------------------------------------------===//

#include "Launch.h"

using namespace mlir::tai::runtime;

void Runtime::setProfiler(bool on) {
  opts.profiler = on;
  profiler->setOn(on);
  updateLaunchState();
  if (device)
    device->queue().setOneByOne(on);
}

bool Runtime::wantsPlaces() const {
  return opts.profiler || (device && device->watch().wantsPlaces());
}

int32_t Runtime::runTimed(Launch &launch, Kernel &kernel,
                          TaiKernelFn function) {
  TraceEvent event{};
  event.thread = profiler->thread();
  event.startNs = event.queuedNs = profiler->now();
  int32_t code = function(&launch);
  event.durationNs = profiler->now() - event.startNs;
  Profiler::Item item =
      profiler->find(ProfileKind::Host, kernel.name(), kernel.place());
  if (launch.onDevice && launch.onDevice->code) {
    profiler->keep(item, event);
    return code;
  }
  profiler->count(item, event);
  profiler->noteBytes({kernel.name()}, kernel.touchedBytes());
  return code;
}

void Runtime::collectTimes() {
  if (!device)
    return;
  noteFailure(device->get().synchronize());
  noteFailure(device->watch().collect());
}

std::vector<ProfileRow> Runtime::profile() {
  collectTimes();
  return profiler->rows();
}

std::vector<TraceEvent> Runtime::trace(int64_t &lost) {
  collectTimes();
  return profiler->events(lost);
}

void Runtime::clearProfile() {
  collectTimes();
  profiler->clear();
}
