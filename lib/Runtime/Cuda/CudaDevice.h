//===- CudaDevice.h - A GPU behind the CUDA driver --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Everything is queued on one stream, so that launches, copies, fills and frees
// are ordered without events. The context is the primary one of the device,
// which other libraries of the process use too.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_CUDA_CUDADEVICE_H
#define TAI_LIB_RUNTIME_CUDA_CUDADEVICE_H

#include "CudaKernels.h"
#include "Driver.h"
#include "RepeatedLaunch.h"
#include "tai/Runtime/Device/Device.h"
#include "tai/Runtime/Threads/Section.h"
#include <map>
#include <mutex>
#include <set>

namespace mlir::tai::runtime::cuda {

struct CudaModule;
struct CudaGraph;
struct CudaEvent;

struct CudaFunction : DeviceFunction {
  Function handle = nullptr;
  unsigned mostThreads = 0;
  std::unique_ptr<RepeatedLaunch> repeated;
};

/// The state of a graph capture on the device's stream.
struct GraphCapture {
  bool isOpen = false;
  /// True if the runtime's own kernels, which copy and fill memory, are
  /// captured with programmatic dependent launch.
  bool overlaps = false;
};

class CudaDevice final : public Device {
public:
  CudaDevice(const Driver &driver, int number) : cu(driver), number(number) {}
  ~CudaDevice() override;
  Status open();

  DeviceKind kind() const override { return DeviceKind::Cuda; }
  std::string name() const override { return label; }
  DeviceLimits limits() const override { return most; }
  std::string target() const override { return architecture; }

  Status allocate(int64_t bytes, DevicePtr &memory) override;
  Status reserve(int64_t bytes, DevicePtr &memory) override;
  void free(DevicePtr memory) override;
  int64_t allocatedBytes() const override {
    std::lock_guard<std::mutex> lock(mutex);
    return allocated;
  }
  int64_t freeBytes() const override;

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
  bool isDeviceMemory(const void *address) const override;

  DeviceAssembler assembler() const override;
  Status load(const DeviceImage &image,
              std::unique_ptr<DeviceModule> &module) override;
  Status find(DeviceModule &module, const std::string &name,
              DeviceFunction *&function) override;
  unsigned mostThreads(const DeviceFunction &function) const override {
    return static_cast<const CudaFunction &>(function).mostThreads;
  }
  unsigned residentBlocks(const DeviceFunction &function,
                          unsigned threads) const override;
  Status launch(DeviceFunction &function, const LaunchShape &shape,
                const uint64_t *slots, int count) override;
  Status beginCapture(size_t numChangeable, bool overlaps) override;
  Status endCapture(std::unique_ptr<DeviceGraph> &graph) override;
  Status fillAside(const std::vector<DeviceFill> &fills) override;
  Status joinAside() override;
  Status run(DeviceGraph &graph) override;
  Status change(DeviceGraph &graph, size_t number, DeviceFunction &function,
                const LaunchShape &shape, const uint64_t *slots,
                int count) override;
  DeviceFunctionFacts facts(const DeviceFunction &function) const override;
  Status record(std::unique_ptr<DeviceEvent> &event) override;
  Status wait(DeviceEvent &event) override;
  Status elapsed(const DeviceEvent &from, const DeviceEvent &to,
                 int64_t &ns) override;
  Status waitForStream(uint64_t other) override;
  Status letStreamWait(uint64_t other) override;
  Status synchronize() override;
  void setStopWord(DevicePtr word) override;

private:
  friend struct CudaModule;
  friend struct CudaGraph;
  friend struct CudaEvent;

  Status launchCluster(Function handle, const LaunchShape &shape,
                       void **parameters);
  Status check(Result result, const char *what) const {
    if (__builtin_expect(result == kSuccess, true))
      return Status::success();
    return failure(result, what);
  }
  Status failure(Result result, const char *what) const;
  /// True if the device's context is current for this thread. The driver is
  /// asked, because another library may have set another context.
  bool isCurrent() const {
    Context current = nullptr;
    return cu.ctxGetCurrent(&current) == kSuccess && current == context;
  }
  Status enter() const {
    Status status = isCurrent() ? Status::success()
                                : check(cu.ctxSetCurrent(context),
                                        "a thread cannot use the device");
    if (status)
      enteredLast = identity;
    return status;
  }
  /// Makes the device's context current for this thread, without a call of the
  /// driver if this thread was the last to do so; for launches.
  Status enterOnce() const {
    return __builtin_expect(enteredLast == identity, true) ? Status::success()
                                                           : enter();
  }
  /// The identity of the device that this thread entered last. Addresses do not
  /// identify devices: a new device can have the address of an old one.
  static thread_local uint64_t enteredLast;
  const uint64_t identity = nextIdentity();
  static uint64_t nextIdentity();
  Status allocateOnce(int64_t bytes, Address &address);
  Status setHeap(size_t memoryBytes);
  /// Makes work that is queued later in the stream `second` wait for the work
  /// now in the stream `first`.
  Status order(Stream first, Stream second);
  Status launchOverlapped(Function handle, const LaunchShape &shape,
                          void **parameters);
  Status fillByKernel(const std::vector<const DeviceFill *> &fills);
  Status fillAlone(const DeviceFill &fill);
  /// True if the runtime's own kernels, which copy and fill memory, use
  /// programmatic dependent launch now: only within a capture that allows it.
  bool doesOverlap() const { return capture.isOpen && capture.overlaps; }

  /// A buffer of pinned host memory, through which small copies to the device
  /// are made.
  static constexpr int64_t stagingBytes = 256 << 10;
  static constexpr int64_t largestStaged = 32 << 10;

  const Driver &cu;
  DeviceNumber number;
  Context context = nullptr;
  Stream stream = nullptr;
  GraphCapture capture;
  /// True if the last work queued on the stream is a kernel.
  bool isAfterKernel = false;
  /// A second stream, for a branch of a graph, or null.
  Stream side = nullptr;
  /// The branch of the captured graph that is recorded on `side`: none, being
  /// captured, or captured and not joined to the main branch yet.
  enum class Branch { None, Capturing, Captured };
  Branch branch = Branch::None;
  Pool pool = nullptr;
  std::string label, architecture;
  DeviceLimits most;
  mutable std::mutex mutex;
  std::map<DevicePtr, int64_t> allocations;
  std::set<DevicePtr> reserved;
  int64_t allocated = 0;

  CudaKernels kernels{*this};

  /// The number of launches at the front of the captured graph that can be
  /// changed.
  size_t numChangeable = 0;

  /// Polls the device, with safepoints, until `query` is no longer "not ready".
  template <typename Query>
  Status waitUntilReady(const Query &query, Result &result);
  /// Asks kernels with safepoints to stop, and waits briefly for their end.
  template <typename Query> void stopLoops(const Query &query);

  /// The word in device memory by which running kernels are asked to stop, or
  /// 0; a separate stream to write this word while kernels run; and two numbers
  /// in host memory that are copied to it: zero, and the number of the thread
  /// that asks.
  DevicePtr stopWord = 0;
  Stream stopStream = nullptr;
  uint32_t *stopSource = nullptr;
  std::mutex stopMutex;

  /// The event that orders the device's stream with streams of other libraries;
  /// created on first use.
  std::mutex orderMutex;
  Event orderEvent = nullptr;

  Section stagingCopies;
  char *staging = nullptr;
  int64_t staged = 0;
};

struct CudaGraph : DeviceGraph {
  explicit CudaGraph(CudaDevice &device) : device(device) {}
  ~CudaGraph() override {
    if (!device.enter())
      return;
    if (handle)
      (void)device.cu.graphExecDestroy(handle);
    if (recorded)
      (void)device.cu.graphDestroy(recorded);
  }
  /// Finds the nodes of the first `count` launches in the captured graph, if
  /// these launches form a chain.
  void findNodes(size_t count);

  CudaDevice &device;
  ExecutableGraph handle = nullptr;
  /// The graph from which `handle` was instantiated, which owns the node
  /// handles; null if no node changes.
  Graph recorded = nullptr;
  std::vector<Node> nodes;
};

struct CudaEvent : DeviceEvent {
  explicit CudaEvent(CudaDevice &device) : device(device) {}
  ~CudaEvent() override {
    if (handle && device.enter())
      (void)device.cu.eventDestroy(handle);
  }

  CudaDevice &device;
  Event handle = nullptr;
};

struct CudaModule : DeviceModule {
  explicit CudaModule(CudaDevice &device) : device(device) {}
  ~CudaModule() override {
    if (!handle || !device.enter())
      return;
    functions.clear();
    (void)device.cu.moduleUnload(handle);
  }

  CudaDevice &device;
  Module handle = nullptr;
  std::map<std::string, CudaFunction> functions;
};

} // namespace mlir::tai::runtime::cuda

#endif // TAI_LIB_RUNTIME_CUDA_CUDADEVICE_H
