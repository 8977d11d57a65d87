//===- DeviceHost.h - The device of a runtime -------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The device of a runtime, initially none. Failures in calls that cannot return
// them are kept, and returned by the next call that can.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_MIRROR_DEVICEHOST_H
#define TAI_RUNTIME_MIRROR_DEVICEHOST_H

#include "tai/Runtime/Device/Device.h"
#include "tai/Runtime/Profile/Profiler.h"
#include "tai/Runtime/Storage/TreeStore.h"
#include "tai/Runtime/Text/Printer.h"

namespace mlir::tai::runtime {

class DeviceContext;
class DeviceQueue;

/// Parts of the runtime that the device layer uses.
struct DeviceServices {
  Printer &printer;
  const MemoryAccount &memory;
  const SkipSet &skips;
  SkipCounters &counters;
};

class DeviceHost final : public TreeMirrors {
public:
  explicit DeviceHost(const DeviceServices &services);
  ~DeviceHost() override;

  /// Sets the device of the runtime, null for none, with at most `memoryLimit`
  /// bytes, 0 for all of its memory.
  void use(std::unique_ptr<Device> device, int64_t memoryLimit);
  bool isThere() const { return context != nullptr; }
  /// The state shared by objects on the device; null if the runtime has no
  /// device.
  DeviceContext *get() const { return context.get(); }
  const std::shared_ptr<DeviceContext> &shared() const { return context; }
  Device *device() const;
  DeviceQueue *queue() const;

  Status check(const std::string &name, int64_t bytes,
               const std::vector<SparseInfo> &levels) const override;
  std::shared_ptr<Mirror> make(Tree &tree, SparseOnDevice *&levels) override;

  /// Fails in a signal handler that has interrupted a step which must be
  /// complete before any other work; see DeviceQueue::checkHandler.
  Status checkHandler() const;
  /// Waits for the work queued on the device; returns its failures, and prints
  /// the output of kernels.
  Status synchronize();
  /// noteFailure keeps the first failure of calls that could not return it;
  /// takeFailure returns this failure and forgets it.
  void noteFailure(Status status);
  bool hasNoted() const;
  Status takeFailure() {
    return __builtin_expect(isThere(), false) ? takeNoted() : Status::success();
  }

  /// Gives the device address of an offset in a tree; fails without a device.
  Status addressOf(const Tree &tree, int64_t offset, void *&address);
  /// Order work of this runtime relative to a stream of another library; see
  /// Device::waitForStream. Without a device, both functions do nothing.
  Status waitForStream(uint64_t stream);
  Status letStreamWait(uint64_t stream);
  /// Allocates device memory for the caller's copies of arrays.
  Status allocate(int64_t bytes, void *&address);
  void free(void *address);
  /// Copies memory on the device. The copy is queued in order with launches,
  /// and like launches it may become part of a collected sequence.
  Status copy(void *to, const void *from, int64_t bytes);
  /// Copies `rows` pieces of `bytes` bytes, `step` bytes apart, to the host.
  Status read(const void *from, int64_t step, int64_t bytes, int64_t rows,
              void *to);
  /// True if kernels on the device can access memory at `address`.
  bool isThere(const void *address) const;

  /// The profiler. collectedProfiler() first waits for the device, so that the
  /// times of all queued work are in the profile.
  Profiler &profiler() const { return *sharedProfiler; }
  void setProfiler(bool on);
  Profiler &collectedProfiler();
  /// True if device code should be compiled with source locations, for
  /// profilers.
  bool wantsPlaces() const;

private:
  Status takeNoted();

  DeviceServices services;
  /// The profiler, shared with the device.
  std::shared_ptr<Profiler> sharedProfiler;
  /// The device's state, shared with the objects that have memory on the
  /// device.
  std::shared_ptr<DeviceContext> context;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_MIRROR_DEVICEHOST_H
