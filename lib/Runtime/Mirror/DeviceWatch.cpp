//===- DeviceWatch.cpp - Profiling of a device's work ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Devices measure the time between events, not absolute times. So one event is
// recorded at a known host time, and each further one is placed by its distance
// from the one before, which is short and therefore accurate.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Mirror/DeviceWatch.h"
#include <algorithm>

using namespace mlir::tai::runtime;

/// The maximum of work whose times have not been read. Beyond it, the oldest
/// are read until `leftPending` remain: the device has finished that work long
/// ago.
static constexpr size_t mostPending = 8192, leftPending = 4096;

struct WatchedDevice::Module : DeviceModule {
  std::unique_ptr<DeviceModule> module;
  std::vector<std::string> functions, places;
};

WatchedDevice::WatchedDevice(std::unique_ptr<Device> device,
                             std::shared_ptr<Profiler> profiler)
    : device(std::move(device)), profiler(std::move(profiler)),
      nvtx(Nvtx::get()) {}

WatchedDevice::~WatchedDevice() = default;

//===----------------------------------------------------------------------===//
// Code
//===----------------------------------------------------------------------===//

Status WatchedDevice::load(const DeviceImage &image,
                           std::unique_ptr<DeviceModule> &module) {
  auto made = std::make_unique<Module>();
  made->functions = image.functions;
  made->places = image.places;
  Status status = device->load(image, made->module);
  if (status)
    module = std::move(made);
  return status;
}

/// The label of a device function in a profile: "name (file:line)".
static std::string labelOf(const std::string &name, const std::string &place) {
  size_t column = place.rfind(':');
  if (place.empty() || column == std::string::npos)
    return name;
  std::string line = place.substr(0, column);
  size_t folder = line.rfind('/');
  if (folder != std::string::npos)
    line = line.substr(folder + 1);
  return name + " (" + line + ")";
}

Status WatchedDevice::find(DeviceModule &module, const std::string &name,
                           DeviceFunction *&function) {
  auto &owner = static_cast<Module &>(module);
  Status status = device->find(*owner.module, name, function);
  if (!status)
    return status;
  auto at = static_cast<size_t>(
      std::find(owner.functions.begin(), owner.functions.end(), name) -
      owner.functions.begin());
  std::string place =
      at < owner.places.size() ? owner.places[at] : std::string();
  Entry entry;
  entry.item = profiler->find(ProfileKind::Device, name, place);
  entry.label = labelOf(name, place);
  Section::Entry section(timing);
  // The entry of a freed function that had the same address is replaced.
  entries[function] = std::move(entry);
  return status;
}

//===----------------------------------------------------------------------===//
// Reading times
//===----------------------------------------------------------------------===//

/// Finds the time of an event on the host's clock: between the time when it was
/// queued and the time when the host has seen its end.
Status WatchedDevice::align() {
  constexpr int tries = 5;
  Status status = device->synchronize();
  int64_t best = INT64_MAX;
  for (int i = 0; i < tries && status; ++i) {
    std::unique_ptr<DeviceEvent> event;
    int64_t before = profiler->now();
    status = device->record(event);
    if (status)
      status = device->wait(*event);
    int64_t after = profiler->now();
    if (status && after - before < best) {
      best = after - before;
      anchorNs = before + (after - before) / 2;
      anchor = std::move(event);
    }
  }
  return status;
}

/// Reads the times of the oldest `count` pieces of pending work, and passes
/// them to the profiler.
Status WatchedDevice::read(size_t count) {
  if (count == 0)
    return Status::success();
  Status status = device->wait(*pending[count - 1].end);
  std::vector<TraceEvent> events;
  int64_t at = anchorNs, late = 0;
  const DeviceEvent *from = anchor.get();
  for (size_t i = 0; i < count && status; ++i) {
    const Pending &work = pending[i];
    int64_t distance = 0, duration = 0;
    status = device->elapsed(*from, *work.begin, distance);
    if (status)
      status = device->elapsed(*work.begin, *work.end, duration);
    at += distance;
    from = work.begin.get();
    // No work begins before it is queued. If the times say so, the offset
    // between the clocks of host and device is wrong and is corrected.
    late = std::max(late, work.queuedNs - at);
    events.push_back({nullptr, true, work.thread, at, duration, work.queuedNs,
                      work.blocks, work.threads});
  }
  for (size_t i = 0; i < events.size(); ++i) {
    events[i].startNs += late;
    profiler->count(pending[i].item, events[i]);
  }
  if (status) {
    anchorNs = at + late;
    unused.push_back(std::move(anchor));
    anchor = std::move(pending[count - 1].begin);
  }
  for (size_t i = 0; i < count; ++i) {
    if (pending[i].begin)
      unused.push_back(std::move(pending[i].begin));
    unused.push_back(std::move(pending[i].end));
  }
  pending.erase(pending.begin(),
                pending.begin() + static_cast<ptrdiff_t>(count));
  return status;
}

Status WatchedDevice::collect() {
  Section::Entry section(timing);
  if (section.isAgain())
    return section.check();
  Status status = read(pending.size());
  // The clocks of host and device drift apart, so they are aligned again for
  // the next work.
  if (anchor)
    unused.push_back(std::move(anchor));
  return status;
}

//===----------------------------------------------------------------------===//
// Work
//===----------------------------------------------------------------------===//

template <typename Work>
Status WatchedDevice::timed(Profiler::Item item, const LaunchShape &shape,
                            Work work) {
  Section::Entry section(timing);
  // Work that a signal handler queues while it interrupts this section is not
  // timed.
  if (section.isAgain())
    return work();
  Status status;
  if (!anchor)
    status = align();
  if (pending.size() >= mostPending && status)
    status = read(pending.size() - leftPending);
  auto take = [&] {
    std::unique_ptr<DeviceEvent> event;
    if (!unused.empty()) {
      event = std::move(unused.back());
      unused.pop_back();
    }
    return event;
  };
  Pending mine{item, take(),       take(),       profiler->thread(),
               0,    shape.blocks, shape.threads};
  mine.queuedNs = profiler->now();
  if (status)
    status = device->record(mine.begin);
  if (status)
    status = work();
  if (status)
    status = device->record(mine.end);
  if (!status)
    return status;
  profiler->keep(item, {nullptr, false, mine.thread, mine.queuedNs,
                        profiler->now() - mine.queuedNs, mine.queuedNs,
                        mine.blocks, mine.threads});
  pending.push_back(std::move(mine));
  return status;
}

template <typename Work>
Status WatchedDevice::memory(const char *name, Work work) {
  if (__builtin_expect(!isWatching(), true))
    return work();
  return timed(profiler->find(ProfileKind::Memory, name, ""), LaunchShape{0, 0},
               work);
}

void WatchedDevice::examine(Entry &entry, const DeviceFunction &function,
                            const LaunchShape &shape) {
  if (!entry.isKnown) {
    entry.facts = device->facts(function);
  } else if (entry.shape.blocks == shape.blocks &&
             entry.shape.threads == shape.threads)
    return;
  entry.isKnown = true;
  entry.shape = shape;
  DeviceLimits limits = device->limits();
  double places =
      double(limits.multiprocessors) * limits.threadsPerMultiprocessor;
  entry.occupancy = places > 0
                        ? device->residentBlocks(function, shape.threads) *
                              double(shape.threads) / places
                        : -1;
  DeviceFunctionFacts facts = entry.facts;
  if (facts.sharedBytes >= 0)
    facts.sharedBytes += static_cast<int>(shape.sharedBytes);
  profiler->noteFacts(entry.item, facts, shape, entry.occupancy);
}

Status WatchedDevice::launch(DeviceFunction &function, const LaunchShape &shape,
                             const uint64_t *slots, int count) {
  auto work = [&] { return device->launch(function, shape, slots, count); };
  bool watching = isWatching();
  if (__builtin_expect(!nvtx && !watching, true))
    return work();
  Entry *entry = nullptr;
  {
    Section::Entry section(timing);
    entry = &entries[&function];
    if (watching)
      examine(*entry, function, shape);
  }
  Nvtx::Range range(capturing ? nullptr : nvtx, entry->label.c_str());
  return watching ? timed(entry->item, shape, work) : work();
}

Status WatchedDevice::copyIn(DevicePtr to, const void *from, int64_t bytes) {
  return memory("copy to the device",
                [&] { return device->copyIn(to, from, bytes); });
}
Status WatchedDevice::copyOut(void *to, DevicePtr from, int64_t bytes) {
  return memory("copy to the host",
                [&] { return device->copyOut(to, from, bytes); });
}
Status WatchedDevice::copy(DevicePtr to, DevicePtr from, int64_t bytes) {
  return memory("copy", [&] { return device->copy(to, from, bytes); });
}
Status WatchedDevice::fill(DevicePtr to, const void *pattern, int patternBytes,
                           int64_t count) {
  return memory("fill",
                [&] { return device->fill(to, pattern, patternBytes, count); });
}
Status WatchedDevice::copyRows(const DeviceRows &to, DevicePtr from,
                               int64_t fromStep) {
  return memory("copy of rows",
                [&] { return device->copyRows(to, from, fromStep); });
}
Status WatchedDevice::swapRows(const DeviceRows &one, DevicePtr other,
                               int64_t otherStep) {
  return memory("exchange of rows",
                [&] { return device->swapRows(one, other, otherStep); });
}
Status WatchedDevice::fillRows(const DeviceRows &to, const void *pattern,
                               int patternBytes) {
  return memory("fill of rows",
                [&] { return device->fillRows(to, pattern, patternBytes); });
}

Status WatchedDevice::fillAll(const std::vector<DeviceFill> &fills) {
  const DeviceRows &first = fills.front().rows;
  bool areRows = fills.size() == 1 && (first.rows > 1 || first.outer > 1);
  return memory(areRows ? "fill of rows" : "fill",
                [&] { return device->fillAll(fills); });
}

Status WatchedDevice::beginCapture(size_t numChangeable, bool overlaps) {
  Status status = device->beginCapture(numChangeable, overlaps);
  capturing = bool(status);
  return status;
}

Status WatchedDevice::endCapture(std::unique_ptr<DeviceGraph> &graph) {
  capturing = false;
  return device->endCapture(graph);
}

Status WatchedDevice::run(DeviceGraph &graph) {
  const char *label = "a sequence of launches, as a graph";
  auto work = [&] { return device->run(graph); };
  Nvtx::Range range(nvtx, label);
  return isWatching() ? timed(profiler->find(ProfileKind::Device, label, ""),
                              LaunchShape{0, 0}, work)
                      : work();
}
