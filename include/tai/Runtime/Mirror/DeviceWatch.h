//===- DeviceWatch.h - Profiling of a device's work -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Wraps a device and, while the profiler is on, records an event before and
// after each piece of work. Nothing waits for the events: they are read when
// there are many, or on demand. If an NVTX tool is attached, work is queued in
// named ranges.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_MIRROR_DEVICEWATCH_H
#define TAI_RUNTIME_MIRROR_DEVICEWATCH_H

#include "tai/Runtime/Profile/Nvtx.h"
#include "tai/Runtime/Profile/Profiler.h"
#include "tai/Runtime/Threads/Section.h"

namespace mlir::tai::runtime {

class WatchedDevice final : public Device {
public:
  WatchedDevice(std::unique_ptr<Device> device,
                std::shared_ptr<Profiler> profiler);
  ~WatchedDevice() override;

  /// Waits for queued work and adds its times to the profiler.
  Status collect();
  /// True if the source locations of functions are used, by the profiler or in
  /// NVTX ranges.
  bool wantsPlaces() const { return nvtx || profiler->isOn(); }
  /// The device for launches while the profiler is off; null if they need NVTX
  /// ranges anyway.
  Device *unwatched() const { return nvtx ? nullptr : device.get(); }

  DeviceKind kind() const override { return device->kind(); }
  std::string name() const override { return device->name(); }
  DeviceLimits limits() const override { return device->limits(); }
  std::string target() const override { return device->target(); }
  Status allocate(int64_t bytes, DevicePtr &memory) override {
    return device->allocate(bytes, memory);
  }
  Status reserve(int64_t bytes, DevicePtr &memory) override {
    return device->reserve(bytes, memory);
  }
  void free(DevicePtr memory) override { device->free(memory); }
  int64_t allocatedBytes() const override { return device->allocatedBytes(); }
  int64_t freeBytes() const override { return device->freeBytes(); }
  bool isDeviceMemory(const void *address) const override {
    return device->isDeviceMemory(address);
  }
  unsigned mostThreads(const DeviceFunction &function) const override {
    return device->mostThreads(function);
  }
  unsigned residentBlocks(const DeviceFunction &function,
                          unsigned threads) const override {
    return device->residentBlocks(function, threads);
  }
  DeviceFunctionFacts facts(const DeviceFunction &function) const override {
    return device->facts(function);
  }
  Status wait(DeviceEvent &event) override { return device->wait(event); }
  Status elapsed(const DeviceEvent &from, const DeviceEvent &to,
                 int64_t &ns) override {
    return device->elapsed(from, to, ns);
  }
  Status record(std::unique_ptr<DeviceEvent> &event) override {
    return device->record(event);
  }
  Status waitForStream(uint64_t stream) override {
    return device->waitForStream(stream);
  }
  Status letStreamWait(uint64_t stream) override {
    return device->letStreamWait(stream);
  }
  Status synchronize() override { return device->synchronize(); }
  void setStopWord(DevicePtr word) override { device->setStopWord(word); }

  Status copyIn(DevicePtr to, const void *from, int64_t bytes) override;
  Status copyOut(void *to, DevicePtr from, int64_t bytes) override;
  Status copy(DevicePtr to, DevicePtr from, int64_t bytes) override;
  Status fill(DevicePtr to, const void *pattern, int patternBytes,
              int64_t count) override;
  Status copyRows(const DeviceRows &to, DevicePtr from,
                  int64_t fromStep) override;
  Status swapRows(const DeviceRows &one, DevicePtr other,
                  int64_t otherStep) override;
  Status fillRows(const DeviceRows &to, const void *pattern,
                  int patternBytes) override;
  Status fillAll(const std::vector<DeviceFill> &fills) override;
  DeviceAssembler assembler() const override { return device->assembler(); }
  Status load(const DeviceImage &image,
              std::unique_ptr<DeviceModule> &module) override;
  Status find(DeviceModule &module, const std::string &name,
              DeviceFunction *&function) override;
  Status launch(DeviceFunction &function, const LaunchShape &shape,
                const uint64_t *slots, int count) override;
  Status beginCapture(size_t numChangeable, bool overlaps) override;
  Status endCapture(std::unique_ptr<DeviceGraph> &graph) override;
  Status fillAside(const std::vector<DeviceFill> &fills) override {
    return device->fillAside(fills);
  }
  Status joinAside() override { return device->joinAside(); }
  Status run(DeviceGraph &graph) override;
  Status change(DeviceGraph &graph, size_t number, DeviceFunction &function,
                const LaunchShape &shape, const uint64_t *slots,
                int count) override {
    return device->change(graph, number, function, shape, slots, count);
  }

private:
  struct Module;
  /// The profiler's data about a device function.
  struct Entry {
    Profiler::Item item = 0;
    /// The name of the NVTX range of the function's launches.
    std::string label;
    bool isKnown = false;
    DeviceFunctionFacts facts;
    /// The launch shape for which the computed occupancy is valid.
    LaunchShape shape;
    double occupancy = -1;
  };
  /// Queued work whose times have not been read from the device yet.
  struct Pending {
    Profiler::Item item;
    std::unique_ptr<DeviceEvent> begin, end;
    int thread;
    int64_t queuedNs;
    unsigned blocks, threads;
  };

  bool isWatching() const { return profiler->isOn() && !capturing; }
  template <typename Work>
  Status timed(Profiler::Item item, const LaunchShape &shape, Work work);
  template <typename Work> Status memory(const char *name, Work work);
  Status align();
  Status read(size_t count);
  void examine(Entry &entry, const DeviceFunction &function,
               const LaunchShape &shape);

  std::unique_ptr<Device> device;
  std::shared_ptr<Profiler> profiler;
  const Nvtx *nvtx;
  bool capturing = false;

  Section timing;
  std::unordered_map<const DeviceFunction *, Entry> entries;
  std::deque<Pending> pending;
  std::vector<std::unique_ptr<DeviceEvent>> unused;
  /// An event on the device and its time on the host's clock, to align both
  /// clocks.
  std::unique_ptr<DeviceEvent> anchor;
  int64_t anchorNs = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_MIRROR_DEVICEWATCH_H
