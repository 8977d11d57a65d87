//===- Device.h - A device with its own memory ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The runtime's interface to a GPU: memory, copies, code and launches, in the
// order of one queue. There are two implementations: the CUDA driver, and an
// emulation that runs the same device functions on the CPU, for tests on
// machines without a GPU. See docs/decisions/0010-cuda.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_DEVICE_DEVICE_H
#define TAI_RUNTIME_DEVICE_DEVICE_H

#include "tai/Support/Status.h"
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace mlir::tai::runtime {

/// An address in the memory of the device; 0 is null.
using DevicePtr = uint64_t;

enum class DeviceKind { Cuda, Emulated };

/// Device code that has been loaded. Created by a Device.
class DeviceModule {
public:
  virtual ~DeviceModule() = default;
};

/// A device function (a kernel) of a module. Lives as long as the module.
class DeviceFunction {
public:
  virtual ~DeviceFunction() = default;
};

/// The launch configuration of a function.
struct LaunchShape {
  unsigned blocks = 1;
  unsigned threads = 1;
  unsigned sharedBytes = 0;
  /// A cooperative launch: all blocks must be resident, because the function
  /// has grid barriers.
  bool cooperative = false;
  /// The number of thread blocks in a thread block cluster; 0 for a launch
  /// without clusters.
  unsigned cluster = 0;
  /// True for a programmatic dependent launch: the function itself waits for
  /// the end of the launch before it.
  bool overlaps = false;
  /// True if the function also runs correctly with fewer than `threads` threads
  /// in a block, where the device has no room for all of them.
  bool canShrink = false;
};

struct DeviceLimits {
  unsigned multiprocessors = 1;
  unsigned threadsPerBlock = 1;
  int64_t memoryBytes = 0;
  /// The number of threads that can be resident on a multiprocessor; 0 if not
  /// known.
  unsigned threadsPerMultiprocessor = 0;
  /// Whether the device can capture queued work as a graph.
  bool hasGraphs = false;
  /// True if cooperative launches, whose functions have grid barriers, are
  /// supported.
  bool hasGridBarriers = false;
  /// The most thread blocks that a cluster can have; 1 if clusters are not
  /// supported.
  unsigned mostClusterBlocks = 1;
  /// The granularity, in bytes, in which reserved memory is committed; 0 if
  /// `reserve` is not supported.
  int64_t reservedPieceBytes = 0;
  /// Whether the device supports programmatic dependent launch.
  bool hasOverlaps = false;
};

/// Work captured from the device's queue, which can be run again as a whole.
/// Created by a Device.
class DeviceGraph {
public:
  virtual ~DeviceGraph() = default;
};

/// A position in the queue of a device. Created by a Device.
class DeviceEvent {
public:
  virtual ~DeviceEvent() = default;
};

/// The resources that a device function needs. Negative numbers are not known.
struct DeviceFunctionFacts {
  int registers = -1;
  /// Bytes of shared memory for a block, of local memory (spills) for a thread,
  /// and of constant memory.
  int sharedBytes = -1, localBytes = -1, constantBytes = -1;
};

/// A compiled kernel's device code, as it is emitted and cached: PTX text for
/// Cuda, an object file for the host for Emulated.
struct DeviceImage {
  DeviceKind kind = DeviceKind::Cuda;
  std::string bytes;
  /// Names of the device functions, by the numbers that host code uses for
  /// them.
  std::vector<std::string> functions;
  /// The source location of each device function, as "file:line:column"; empty
  /// unless the compilation was asked for locations.
  std::vector<std::string> places;
  /// LLVM bitcode of the device code, with which kernels are fused into
  /// programs; null if fusion is off.
  std::shared_ptr<const std::string> bitcode;
  /// The memory accesses of each device function, as FunctionAccesses encodes
  /// them. Possibly has fewer entries than there are functions.
  std::vector<std::vector<int64_t>> accesses = {};
  /// The block size of each device function, if its loop specifies one; else 0.
  /// Possibly has fewer entries than there are functions.
  std::vector<int64_t> blockSizes = {};
  /// The key of the image in the compilation cache; empty without a cache.
  std::string key = {};
  /// The image assembled to machine code of one device; empty if not assembled.
  std::string machineCode = {};
  /// Compiles the kernel's device code again and replaces the cache entry;
  /// called if a device rejects an image from the cache.
  std::function<Status(DeviceImage &fresh)> makeAgain = nullptr;

  unsigned blockSize(size_t function) const {
    return function < blockSizes.size()
               ? static_cast<unsigned>(blockSizes[function])
               : 0;
  }
};

/// An assembler: adds machine code to an image, or leaves the image as it is if
/// the device does not take the code. Any thread may call it, also after the
/// device is destroyed.
using DeviceAssembler = std::function<void(DeviceImage &image)>;

/// A strided region of device memory: `rows` pieces of `rowBytes` bytes, with
/// `step` bytes from the start of one piece to the start of the next.
struct DeviceRows {
  DevicePtr address;
  int64_t step;
  int64_t rowBytes;
  int64_t rows;
  /// For fills only: the region is repeated `outer` times, with `outerStep`
  /// bytes from one start to the next.
  int64_t outerStep = 0;
  int64_t outer = 1;
};

/// A fill of a strided region with a pattern of `patternBytes` bytes. `pattern`
/// holds repetitions of the pattern up to eight bytes.
struct DeviceFill {
  DeviceRows rows;
  uint64_t pattern;
  int patternBytes;
  /// True if the region was merged from adjacent fills, possibly of separate
  /// allocations: a kernel may write across allocations, but a driver call may
  /// not.
  bool isJoined = false;
};

class Device {
public:
  virtual ~Device() = default;

  virtual DeviceKind kind() const = 0;
  /// The name of the device for display: "NVIDIA H200", "emulated".
  virtual std::string name() const = 0;
  virtual DeviceLimits limits() const = 0;
  /// The name of the target for which code is compiled: "sm_90"; the CPU for an
  /// emulation.
  virtual std::string target() const = 0;

  //===--------------------------------------------------------------------===//
  // Memory. All calls but `allocate` and `free` are queued in order; copies
  // from or to memory of the host have finished when the call returns.
  //===--------------------------------------------------------------------===//

  virtual Status allocate(int64_t bytes, DevicePtr &memory) = 0;
  /// Reserves zero-initialised memory, possibly more than the device has,
  /// because memory is committed in pieces when first touched. Not included in
  /// allocatedBytes(). See DeviceLimits::reservedPieceBytes.
  virtual Status reserve(int64_t bytes, DevicePtr &memory);
  /// Frees device memory. Waits, if necessary, for queued work that uses the
  /// memory.
  virtual void free(DevicePtr memory) = 0;
  /// The bytes allocated through this object, and the bytes still free on the
  /// device.
  virtual int64_t allocatedBytes() const = 0;
  virtual int64_t freeBytes() const = 0;

  virtual Status copyIn(DevicePtr to, const void *from, int64_t bytes) = 0;
  virtual Status copyOut(void *to, DevicePtr from, int64_t bytes) = 0;
  virtual Status copy(DevicePtr to, DevicePtr from, int64_t bytes) = 0;
  /// Stores `count` copies of a pattern of 1, 2, 4 or 8 bytes; `to` must be
  /// aligned to its size.
  virtual Status fill(DevicePtr to, const void *pattern, int patternBytes,
                      int64_t count) = 0;
  /// Copies strided rows. The rows of both sides have the size given in `to`
  /// (in swapRows, `one`), and do not overlap.
  virtual Status copyRows(const DeviceRows &to, DevicePtr from,
                          int64_t fromStep) = 0;
  virtual Status swapRows(const DeviceRows &one, DevicePtr other,
                          int64_t otherStep) = 0;
  /// Fills a strided region with a pattern. The size of a row is a multiple of
  /// the size of the pattern.
  virtual Status fillRows(const DeviceRows &to, const void *pattern,
                          int patternBytes) = 0;
  /// Runs `fills` in any order: the caller ensures that they are disjoint, or
  /// write the same bytes.
  virtual Status fillAll(const std::vector<DeviceFill> &fills);
  /// Whether device code can access the memory at `address` directly.
  virtual bool isDeviceMemory(const void *address) const = 0;

  //===--------------------------------------------------------------------===//
  // Code
  //===--------------------------------------------------------------------===//

  /// The assembler for images of this device; null if loading takes no time
  /// that could be saved.
  virtual DeviceAssembler assembler() const { return nullptr; }
  virtual Status load(const DeviceImage &image,
                      std::unique_ptr<DeviceModule> &module) = 0;
  virtual Status find(DeviceModule &module, const std::string &name,
                      DeviceFunction *&function) = 0;
  /// The maximum number of threads in a block of a device function.
  virtual unsigned mostThreads(const DeviceFunction &function) const = 0;
  /// The number of blocks of `threads` threads that can be resident on the
  /// device.
  virtual unsigned residentBlocks(const DeviceFunction &function,
                                  unsigned threads) const = 0;
  virtual DeviceFunctionFacts facts(const DeviceFunction &) const { return {}; }
  /// Queues a launch. `slots` holds the parameters, each in its own type at the
  /// start of a slot of eight bytes.
  virtual Status launch(DeviceFunction &function, const LaunchShape &shape,
                        const uint64_t *slots, int count) = 0;

  //===--------------------------------------------------------------------===//
  // Graphs
  //===--------------------------------------------------------------------===//

  /// Starts to capture queued work as a graph instead of running it. If the
  /// work starts with launches, the first `numChangeable` launches can be
  /// changed later. With `overlaps`, the runtime's own kernels use programmatic
  /// dependent launch where possible, like launches with LaunchShape::overlaps.
  virtual Status beginCapture(size_t numChangeable = 0, bool overlaps = false);
  /// Ends the capture. If `graph` is given and differs only in parameters, it
  /// is updated; otherwise it is replaced.
  virtual Status endCapture(std::unique_ptr<DeviceGraph> &graph);
  /// Queues a graph.
  virtual Status run(DeviceGraph &graph);
  /// fillAside: like fillAll, on a parallel branch of the graph that is being
  /// captured, at most once in a graph. joinAside: makes later work of the
  /// graph wait for that branch.
  virtual Status fillAside(const std::vector<DeviceFill> &fills);
  virtual Status joinAside();
  /// Changes the parameters of a captured launch, from the next run of the
  /// graph on. The function must be the captured one.
  virtual Status change(DeviceGraph &graph, size_t number,
                        DeviceFunction &function, const LaunchShape &shape,
                        const uint64_t *slots, int count);

  //===--------------------------------------------------------------------===//
  // Times
  //===--------------------------------------------------------------------===//

  /// Records an event at the end of the queue: reuses `event` if it is not
  /// null.
  virtual Status record(std::unique_ptr<DeviceEvent> &event);
  /// Waits until the device's queue has reached the event.
  virtual Status wait(DeviceEvent &event);
  /// Nanoseconds between two events that the device has passed.
  virtual Status elapsed(const DeviceEvent &from, const DeviceEvent &to,
                         int64_t &ns);

  //===--------------------------------------------------------------------===//
  // Queues of other libraries
  //===--------------------------------------------------------------------===//

  /// waitForStream: work queued later on this device waits for the work now in
  /// the other queue; letStreamWait: work queued later in the other queue waits
  /// for the work now queued on this device. `stream` is a CUDA stream, or 0
  /// for the default stream. For an emulated device, `stream` is the address of
  /// a C function `void (int32_t)` that models a stream: called with 0, the
  /// function runs its pending work; called with 1, it is notified that all
  /// work queued on this device is done. A default stream has no work.
  virtual Status waitForStream(uint64_t stream);
  virtual Status letStreamWait(uint64_t stream);

  /// Waits for all queued work, and reports failures. If the wait is
  /// interrupted at a safepoint, kernels with safepoints are stopped as well.
  virtual Status synchronize() = 0;
  /// Sets the address of the word by which the host asks running kernels to
  /// stop: see TaiDeviceState::stop.
  virtual void setStopWord(DevicePtr) {}
};

/// Opens device number `ordinal` of the CUDA driver. The failure names the
/// missing part: the driver, a new enough driver, or a device. The environment
/// variable TAI_CUDA_DRIVER names another library to load as the driver.
Status openCudaDevice(int ordinal, std::unique_ptr<Device> &device);

/// Links an object file into memory and looks up functions by name; the address
/// is null for a function that is not found. The addresses are valid while
/// `library` lives.
using ObjectLinker = std::function<Status(
    std::string_view object, const std::vector<std::string> &names,
    std::vector<void *> &addresses, std::shared_ptr<void> &library)>;

/// Runs device code on the CPU, one thread at a time. For each function `f` an
/// image holds `f.slots`, a C function `void (const uint64_t *slots)` that runs
/// one thread, which gets its position from the functions below.
std::unique_ptr<Device> openEmulatedDevice(ObjectLinker linker);

} // namespace mlir::tai::runtime

extern "C" {
/// The position of the emulated device thread that runs on this host thread.
int32_t tai_emu_thread_id(void);
int32_t tai_emu_block_id(void);
int32_t tai_emu_block_dim(void);
int32_t tai_emu_grid_dim(void);
/// See DeviceAbi.h.
int32_t tai_emu_begin_group(void);
void tai_emu_next_in_group(void);
void tai_emu_end_group(void);
}

#endif // TAI_RUNTIME_DEVICE_DEVICE_H
