//===- DeviceHost.h - The device that a runtime may have --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// None, at first. What cannot be said where it goes wrong is noted, and said by
// the call after.
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

/// What the device of a runtime shares with its host.
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

  /// Null for none, with at most so many bytes there, 0 for what it has.
  void use(std::unique_ptr<Device> device, int64_t memoryLimit);
  bool isThere() const { return context != nullptr; }
  /// Null where there is none.
  DeviceContext *get() const { return context.get(); }
  const std::shared_ptr<DeviceContext> &shared() const { return context; }
  Device *device() const;
  DeviceQueue *queue() const;

  Status check(const std::string &name, int64_t bytes,
               const std::vector<SparseInfo> &levels) const override;
  std::shared_ptr<Mirror> make(Tree &tree, SparseOnDevice *&levels) override;

  /// Waits for what is queued; reports what failed, and prints what kernels
  /// have printed.
  Status synchronize();
  /// Keeps the first failure of what could not say so itself; and takes it.
  void noteFailure(Status status);
  Status takeFailure() {
    return __builtin_expect(isThere(), false) ? takeNoted() : Status::success();
  }

  /// Where device code finds a place in a tree; fails without a device.
  Status addressOf(const Tree &tree, int64_t offset, void *&address);
  /// What is queued from now on waits for what another library has queued, and
  /// the other way round. The stream is one of CUDA, 0 for the default one;
  /// nothing happens without a device.
  Status waitForStream(uint64_t stream);
  Status letStreamWait(uint64_t stream);
  /// Memory of the device for what a caller keeps of arrays there.
  Status allocate(int64_t bytes, void *&address);
  void free(void *address);
  /// Copies there, in the order of the launches; part of what is collected.
  Status copy(void *to, const void *from, int64_t bytes);
  /// Whether kernels can use the address where they run on a device.
  bool isThere(const void *address) const;

  /// What ran while it was on. Waits for the device to be looked at.
  Profiler &profiler() const { return *sharedProfiler; }
  void setProfiler(bool on);
  Profiler &collectedProfiler();
  /// Whether device code should say where it stands in the source.
  bool wantsPlaces() const;

private:
  Status takeNoted();

  DeviceServices services;
  /// Shared with the device.
  std::shared_ptr<Profiler> sharedProfiler;
  /// Shared with what lies on it.
  std::shared_ptr<DeviceContext> context;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_MIRROR_DEVICEHOST_H
