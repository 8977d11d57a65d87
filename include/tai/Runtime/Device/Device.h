//===- Device.h - A processor with memory of its own ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What the runtime asks of a GPU: memory, copies, code and launches, in the
// order of one queue. There are two: that of the CUDA driver, and one that runs
// the same device functions on the CPU, for tests on machines without a GPU.
// See docs/decisions/0010-cuda.md.
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

/// An address in the memory of the device; 0 is none.
using DevicePtr = uint64_t;

/// What device code is compiled for.
enum class DeviceKind { Cuda, Emulated };

/// Code that has been loaded. Made and owned by a Device.
class DeviceModule {
public:
  virtual ~DeviceModule() = default;
};

/// A function of a module that can be launched. Lives as long as the module.
class DeviceFunction {
public:
  virtual ~DeviceFunction() = default;
};

/// How many blocks of how many threads run a function.
struct LaunchShape {
  unsigned blocks = 1;
  unsigned threads = 1;
  unsigned sharedBytes = 0;
  /// All blocks must run at the same time: the function has barriers over the
  /// grid.
  bool cooperative = false;
  /// Blocks of a cluster; 0 for no clusters.
  unsigned cluster = 0;
  /// The function waits for the launch before it by itself.
  bool overlaps = false;
};

struct DeviceLimits {
  unsigned multiprocessors = 1;
  unsigned threadsPerBlock = 1;
  int64_t memoryBytes = 0;
  /// How many threads a multiprocessor can hold; 0 for not known.
  unsigned threadsPerMultiprocessor = 0;
  /// Sequences of work can be recorded and run again.
  bool hasGraphs = false;
  /// All blocks of a kernel can wait for each other.
  bool hasGridBarriers = false;
  /// The most blocks of a cluster; 1 for no clusters.
  unsigned mostClusterBlocks = 1;
  /// Of memory that is reserved, so many bytes take room at a time; 0 where
  /// none can be.
  int64_t reservedPieceBytes = 0;
  /// A kernel can be made ready while the one before it runs.
  bool hasOverlaps = false;
};

/// Work that has been recorded. Made by a Device.
class DeviceGraph {
public:
  virtual ~DeviceGraph() = default;
};

/// A place in the queue of a device. Made by a Device.
class DeviceEvent {
public:
  virtual ~DeviceEvent() = default;
};

/// What a thread or a block of a function takes of the device. Negative where
/// that is not known.
struct DeviceFunctionFacts {
  int registers = -1;
  /// Of a block; of a thread, for what found no room in registers; of
  /// constants.
  int sharedBytes = -1, localBytes = -1, constantBytes = -1;
};

/// A compiled kernel's device code, as the compiler leaves it and the cache
/// keeps it: PTX text for Cuda, an object file for the host for Emulated.
struct DeviceImage {
  DeviceKind kind = DeviceKind::Cuda;
  std::string bytes;
  /// Names of the functions in the order in which the host's part numbers
  /// them.
  std::vector<std::string> functions;
  /// Where each of them stands in the source, as "file:line:column"; empty
  /// where nobody has asked for it.
  std::vector<std::string> places;
  /// LLVM bitcode of the same, to be put together with that of other kernels.
  /// Null where that is not wanted.
  std::shared_ptr<const std::string> bitcode;
  /// What each function touches, as FunctionAccesses encodes it. May have fewer
  /// entries than there are functions.
  std::vector<std::vector<int64_t>> accesses = {};
  /// How many threads the blocks of each function have, where its loop says so;
  /// 0 for any number. May have fewer entries than there are functions.
  std::vector<int64_t> blockSizes = {};
  /// What the cache knows the code by; empty without one.
  std::string key = {};
  /// Of code from the cache: compiles it anew, and puts it there in the place
  /// of this, which the device does not take.
  std::function<Status(DeviceImage &fresh)> makeAgain = nullptr;

  unsigned blockSize(size_t function) const {
    return function < blockSizes.size()
               ? static_cast<unsigned>(blockSizes[function])
               : 0;
  }
};

/// `rows` pieces of `rowBytes` bytes, each starting `step` bytes after the one
/// before.
struct DeviceRows {
  DevicePtr address;
  int64_t step;
  int64_t rowBytes;
  int64_t rows;
  /// All of that so many times, one starting `outerStep` bytes after the one
  /// before. Fills alone look at these.
  int64_t outerStep = 0;
  int64_t outer = 1;
};

/// Rows of a pattern, which stands here again and again, to eight bytes.
struct DeviceFill {
  DeviceRows rows;
  uint64_t pattern;
  int patternBytes;
  /// Made of several that lay side by side, perhaps in pieces of memory that
  /// were allocated apart: a kernel may write them in one go, the driver not.
  bool isJoined = false;
};

class Device {
public:
  virtual ~Device() = default;

  virtual DeviceKind kind() const = 0;
  /// For people: "NVIDIA H200", "emulated".
  virtual std::string name() const = 0;
  virtual DeviceLimits limits() const = 0;
  /// What the code must be compiled for: "sm_90"; the CPU for an emulation.
  virtual std::string target() const = 0;

  //===--------------------------------------------------------------------===//
  // Memory. All but `allocate` and `free` are queued in order; the copies that
  // involve the host's memory have read or written it when they return.
  //===--------------------------------------------------------------------===//

  virtual Status allocate(int64_t bytes, DevicePtr &memory) = 0;
  /// Addresses of memory that holds zeros and may be larger than the device: it
  /// takes room in pieces, where it is touched. It counts as nothing that is
  /// allocated. See DeviceLimits::reservedPieceBytes.
  virtual Status reserve(int64_t bytes, DevicePtr &memory);
  /// Waits, where it must, for what uses the memory.
  virtual void free(DevicePtr memory) = 0;
  /// What is allocated now, and what the device has left.
  virtual int64_t allocatedBytes() const = 0;
  virtual int64_t freeBytes() const = 0;

  virtual Status copyIn(DevicePtr to, const void *from, int64_t bytes) = 0;
  virtual Status copyOut(void *to, DevicePtr from, int64_t bytes) = 0;
  virtual Status copy(DevicePtr to, DevicePtr from, int64_t bytes) = 0;
  /// `count` times a pattern of 1, 2, 4 or 8 bytes, to an address that is a
  /// multiple of its size.
  virtual Status fill(DevicePtr to, const void *pattern, int patternBytes,
                      int64_t count) = 0;
  /// The same for memory that is not dense. Rows of both sides have the bytes
  /// of `to`; they do not overlap.
  virtual Status copyRows(const DeviceRows &to, DevicePtr from,
                          int64_t fromStep) = 0;
  virtual Status swapRows(const DeviceRows &one, DevicePtr other,
                          int64_t otherStep) = 0;
  /// Rows are whole numbers of patterns.
  virtual Status fillRows(const DeviceRows &to, const void *pattern,
                          int patternBytes) = 0;
  /// All of these, in any order: they have no memory in common, or fill it with
  /// the same bytes.
  virtual Status fillAll(const std::vector<DeviceFill> &fills);
  /// Whether device code can use this address of the caller as it is.
  virtual bool isDeviceMemory(const void *address) const = 0;

  //===--------------------------------------------------------------------===//
  // Code
  //===--------------------------------------------------------------------===//

  virtual Status load(const DeviceImage &image,
                      std::unique_ptr<DeviceModule> &module) = 0;
  virtual Status find(DeviceModule &module, const std::string &name,
                      DeviceFunction *&function) = 0;
  /// The most threads that a block of this function can have, and a good
  /// number.
  virtual unsigned mostThreads(const DeviceFunction &function) const = 0;
  /// How many blocks of so many threads the device can run at a time.
  virtual unsigned residentBlocks(const DeviceFunction &function,
                                  unsigned threads) const = 0;
  virtual DeviceFunctionFacts facts(const DeviceFunction &) const { return {}; }
  /// Queues a launch. `slots` holds the parameters, each in its own type at
  /// the start of eight bytes.
  virtual Status launch(DeviceFunction &function, const LaunchShape &shape,
                        const uint64_t *slots, int count) = 0;

  //===--------------------------------------------------------------------===//
  // Graphs
  //===--------------------------------------------------------------------===//

  /// What is queued from now on is recorded instead. If it starts with
  /// launches, the first `numChangeable` of these can be changed. With
  /// `overlaps`, what the device does by kernels of its own is made ready early
  /// where it can be, as are launches whose shape says so.
  virtual Status beginCapture(size_t numChangeable = 0, bool overlaps = false);
  /// Ends that. A graph that is given is changed into the new one where they
  /// differ in parameters alone, else replaced.
  virtual Status endCapture(std::unique_ptr<DeviceGraph> &graph);
  /// Queues what has been recorded.
  virtual Status run(DeviceGraph &graph);
  /// The same as fillAll for a graph that is recorded, once in each: beside
  /// what is queued from now on, until that is to wait for it.
  virtual Status fillAside(const std::vector<DeviceFill> &fills);
  virtual Status joinAside();
  /// Gives a launch of the graph other parameters, from the next run on. The
  /// function is that which was recorded.
  virtual Status change(DeviceGraph &graph, size_t number,
                        DeviceFunction &function, const LaunchShape &shape,
                        const uint64_t *slots, int count);

  //===--------------------------------------------------------------------===//
  // Times
  //===--------------------------------------------------------------------===//

  /// Puts an event at the end of the queue: a new one, or one that is given and
  /// no longer needed where it was.
  virtual Status record(std::unique_ptr<DeviceEvent> &event);
  /// Waits until the device has come there.
  virtual Status wait(DeviceEvent &event);
  /// Nanoseconds from one to the other, both of which the device has passed.
  virtual Status elapsed(const DeviceEvent &from, const DeviceEvent &to,
                         int64_t &ns);

  //===--------------------------------------------------------------------===//
  // Queues of other libraries
  //===--------------------------------------------------------------------===//

  /// What is queued from now on waits for what the other queue holds now, and
  /// the other way round. Of CUDA, a stream, or 0 for the default one. Of an
  /// emulated device, the address of a C function `void (int32_t)` that stands
  /// for a stream: called with 0, it does what it holds; with 1, it hears that
  /// all that was queued here has been done. Default streams hold nothing.
  virtual Status waitForStream(uint64_t stream);
  virtual Status letStreamWait(uint64_t stream);

  /// Waits for all that is queued; reports what failed. Where the wait is
  /// interrupted, loops of kernels that may be long end as well.
  virtual Status synchronize() = 0;
  /// The word of device memory by which they are told: see TaiDeviceState.
  virtual void setStopWord(DevicePtr) {}
};

/// Opens the CUDA driver and the device of this number. The failure says what
/// is missing: the driver, a driver new enough, a device. The environment
/// variable TAI_CUDA_DRIVER names another library to take for the driver.
Status openCudaDevice(int ordinal, std::unique_ptr<Device> &device);

/// Places an object file in memory and finds functions in it by their names;
/// null for one that it does not hold. They stay until `library` goes.
using ObjectLinker = std::function<Status(
    std::string_view object, const std::vector<std::string> &names,
    std::vector<void *> &addresses, std::shared_ptr<void> &library)>;

/// Runs device code on the CPU, one thread at a time. Of each function `f` an
/// image holds `f.slots`, a C function `void (const uint64_t *slots)` that runs
/// one thread; it asks for its place by the functions below.
std::unique_ptr<Device> openEmulatedDevice(ObjectLinker linker);

} // namespace mlir::tai::runtime

extern "C" {
/// The place of the emulated thread that runs on this thread of the host.
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
