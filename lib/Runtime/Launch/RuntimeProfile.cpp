//===- RuntimeProfile.cpp - What one sees of a runtime --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The profiler, what kernels print, and counters. On the CPU a kernel takes the
// time of its launch. On a device that is the time to queue it, which is kept
// for the trace alone: its loops are timed where they run (see DeviceWatch.h).
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

//===----------------------------------------------------------------------===//
// Print, counters
//===----------------------------------------------------------------------===//

void Runtime::setPrintSink(Sink newSink) {
  std::lock_guard<std::mutex> lock(printMutex);
  sink = std::move(newSink);
}

void Runtime::print(std::string_view line) {
  std::lock_guard<std::mutex> lock(printMutex);
  if (sink) {
    sink(line);
    return;
  }
  std::fwrite(line.data(), 1, line.size(), stdout);
  std::fflush(stdout);
}

Counters Runtime::counters() const {
  Counters result;
  result.launches =
      static_cast<int64_t>(hot.launches.load(std::memory_order_relaxed));
  result.forks = counts.forks.load(std::memory_order_relaxed);
  result.inlineLoops = counts.inlineLoops.load(std::memory_order_relaxed);
  result.recorded = skipCounts.get(SkipCount::TapeRecorded);
  result.replayed = skipCounts.get(SkipCount::TapeReplayed);
  result.skipped = skipCounts.get(SkipCount::TapeSkipped);
  result.clearedFields = skipCounts.get(SkipCount::FieldsCleared);
  return result;
}
