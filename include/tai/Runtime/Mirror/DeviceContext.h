//===- DeviceContext.h - Device resources of a runtime ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The device of a runtime, accounting of its memory, the state that device code
// uses for failures and output, and the loaded code of kernels.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_MIRROR_DEVICECONTEXT_H
#define TAI_RUNTIME_MIRROR_DEVICECONTEXT_H

#include "tai/Runtime/Mirror/DeviceHost.h"
#include "tai/Runtime/Mirror/DeviceWatch.h"
#include "tai/Runtime/Mirror/LibraryKernels.h"
#include "tai/Runtime/Queue/DeviceQueue.h"
#include "tai/Runtime/Threads/Section.h"
#include <atomic>
#include <map>
#include <mutex>

namespace mlir::tai::runtime {

class Mirror;

class DeviceContext {
public:
  /// `limit`: maximum bytes on the device; 0 for all of its memory.
  DeviceContext(const DeviceServices &services, std::unique_ptr<Device> device,
                int64_t limit, std::shared_ptr<Profiler> profiler);
  ~DeviceContext();
  DeviceContext(const DeviceContext &) = delete;
  DeviceContext &operator=(const DeviceContext &) = delete;

  const DeviceServices &host() const { return services; }
  Device &get() const { return *device; }
  DeviceQueue &queue() const { return *device; }
  /// The device as the queue of work sees it.
  WatchedDevice &watch() const { return *watched; }
  LibraryKernels &library() { return *libraryKernels; }

  /// Allocates device memory; if there is too little, the failure lists the
  /// owners of the allocated blocks. Thread-safe.
  Status allocate(int64_t bytes, const std::string &owner, DevicePtr &memory);
  /// Reserves device memory that is committed on use; see Device::reserve.
  Status reserve(int64_t bytes, const std::string &owner, DevicePtr &memory);
  void free(DevicePtr memory);
  /// Pooled memory that only queued work uses, such as saved values of tapes:
  /// the memory of one recording is reused for the next one, at the same
  /// addresses.
  Status take(int64_t bytes, const std::string &owner, DevicePtr &memory);
  void giveBack(int64_t bytes, DevicePtr memory);
  /// mostBytes: the limit of device memory. leftToReserved: the bytes that
  /// reserved memory may still commit, when it has committed `taken` bytes.
  int64_t mostBytes() const;
  int64_t leftToReserved(int64_t taken);

  /// Gives the address of the device state (TaiDeviceState), which is allocated
  /// at the first call.
  Status state(DevicePtr &memory);
  /// Notes that device code may have written to the TaiDeviceState.
  void noteStateUsed() { stateUsed.store(true, std::memory_order_relaxed); }
  /// Prints the output of device code, and returns its failure. Must be called
  /// after waiting for the device.
  Status report();

  /// Starts collecting work, with the same scratch memory as the work collected
  /// before, so that both collections can use the same graph.
  void beginCollecting(bool isReplay) {
    // Deferred launches already use the current scratch memory, so it is kept.
    if (!device->keepsLaunches() && !device->isGathering())
      collections.fetch_add(1, std::memory_order_relaxed);
    device->beginCollecting(isReplay);
  }
  Status endCollecting() {
    Status status = device->endCollecting();
    if (device->expectsLaunches())
      collections.fetch_add(1, std::memory_order_relaxed);
    return status;
  }
  /// Begin and end the collection of launches that a tape records; see
  /// DeviceQueue.
  void beginRecording();
  void endRecording(bool isSwept);
  uint64_t numCollections() const {
    return collections.load(std::memory_order_relaxed);
  }

  /// Keeps the first failure of calls that cannot return it.
  void note(Status status);
  void noteOutOfMemory() noexcept;
  bool hasNoted() const { return noted.load(std::memory_order_relaxed); }
  Status take() {
    return __builtin_expect(noted.load(std::memory_order_relaxed), false)
               ? takeNoted()
               : Status::success();
  }

private:
  Status takeNoted();
  Status allocateNow(int64_t bytes, DevicePtr &memory);
  void dropSpare();

  // Read by each launch.
  std::unique_ptr<DeviceQueue> device;
  std::atomic<bool> noted{false};
  std::atomic<bool> stateUsed{false};
  std::atomic<uint64_t> collections{0};

  DeviceServices services;
  WatchedDevice *watched;
  std::unique_ptr<LibraryKernels> libraryKernels;
  int64_t limit;
  /// The mutex is recursive, because allocating may run queued work, and with
  /// it a signal handler that allocates.
  std::recursive_mutex mutex;
  Section makingState;
  struct Holding {
    std::string owner;
    int64_t bytes;
  };
  std::map<DevicePtr, Holding> holdings;
  /// Pooled memory by size, in the order in which it was returned.
  std::multimap<int64_t, DevicePtr> spare;
  int numRecordings = 0;
  int64_t held = 0;
  DevicePtr stateMemory = 0;
  Status failure;
};

/// Owned device memory.
class DeviceBlock {
public:
  ~DeviceBlock() {
    if (keptBytes > 0)
      context->giveBack(keptBytes, memory);
    else
      context->free(memory);
  }
  DeviceBlock(const DeviceBlock &) = delete;
  DeviceBlock &operator=(const DeviceBlock &) = delete;
  static Status make(const std::shared_ptr<DeviceContext> &context,
                     int64_t bytes, const std::string &owner,
                     std::unique_ptr<DeviceBlock> &block) {
    DevicePtr memory = 0;
    Status status = context->allocate(bytes, owner, memory);
    if (status)
      block.reset(new DeviceBlock(context, memory, 0));
    return status;
  }
  /// Makes a block of pooled memory, for values that a tape saves.
  static Status makeKept(const std::shared_ptr<DeviceContext> &context,
                         int64_t bytes, std::unique_ptr<DeviceBlock> &block) {
    DevicePtr memory = 0;
    Status status = context->take(bytes, "values that tapes keep", memory);
    if (status)
      block.reset(new DeviceBlock(context, memory, bytes));
    return status;
  }
  DevicePtr get() const { return memory; }

private:
  DeviceBlock(std::shared_ptr<DeviceContext> context, DevicePtr memory,
              int64_t keptBytes)
      : context(std::move(context)), memory(memory), keptBytes(keptBytes) {}

  std::shared_ptr<DeviceContext> context;
  DevicePtr memory;
  int64_t keptBytes;
};

class BlockTrials;

/// The loaded device code of a kernel, and the trees that it uses.
struct DeviceCode {
  explicit DeviceCode(std::shared_ptr<DeviceContext> context)
      : context(std::move(context)) {}

  struct Function {
    DeviceFunction *function;
    unsigned threads;
    /// The number of blocks of `threads` threads that can be resident.
    unsigned mostBlocks;
    /// True if the kernel's loop specifies the block size `threads`, which is
    /// then not tuned.
    bool hasSize;
    /// The trials that choose the block size; null if it is not tuned.
    std::shared_ptr<BlockTrials> trials;
  };

  std::shared_ptr<DeviceContext> context;
  std::shared_ptr<const DeviceImage> image;
  std::unique_ptr<DeviceModule> module;
  std::vector<Function> functions;
  /// The mirrors of the kernel's trees, in order; and the mirrors of trees that
  /// the kernel changes.
  std::vector<Mirror *> mirrors, changed;
  std::vector<void *> bases;
  /// The epoch of the storage for which the mirrors and base addresses are
  /// valid.
  std::atomic<uint64_t> epoch{0};
};

/// The device state of a launch object, reused for later launches.
struct DeviceLaunch {
  explicit DeviceLaunch(std::shared_ptr<DeviceContext> deviceContext)
      : context(std::move(deviceContext)),
        multiprocessors(context->get().limits().multiprocessors) {}
  ~DeviceLaunch();

  /// Gives zeroed scratch memory from a block. A block that is used up is
  /// zeroed again, in order with launches, and reused.
  Status scratch(int64_t bytes, DevicePtr &result);
  /// Gives device memory that holds a copy of the caller's array.
  Status array(void *host, int64_t bytes, bool written, DevicePtr &result);
  /// The mirror of the tree with this device address, or null.
  Mirror *mirrorOf(const void *base) const {
    for (size_t i = 0; code && i < code->bases.size(); ++i)
      if (code->bases[i] == base)
        return code->mirrors[i];
    return nullptr;
  }
  /// Ends the launch: copies written arrays back to the caller, and frees
  /// temporary memory.
  Status finish();
  /// True if a launch that has been queued needs neither copies back to the
  /// host nor a look at the TaiDeviceState.
  bool isFinished() const { return !usesState && memory == Memory::Trees; }

  std::shared_ptr<DeviceContext> context;
  const DeviceCode *code = nullptr;
  unsigned multiprocessors;
  bool usesState = false;
  /// True if the device has been synchronised since work was last queued.
  bool waited = false;

private:
  /// The kinds of device memory that a launch uses. Each enumerator means that
  /// the launch also uses the memory of the enumerators before it.
  enum class Memory {
    Trees,
    /// The memory on the device that belongs to no tree: scratch memory, and
    /// copies of the caller's arrays.
    Temporary,
    /// Device memory that belongs to another library, such as an imported
    /// array; the launch may use trees and temporary memory as well.
    Others
  };
  Memory memory = Memory::Trees;

  struct Array {
    void *host;
    DevicePtr memory;
    int64_t bytes;
    bool written;
  };
  std::vector<Array> arrays;
  DevicePtr block = 0;
  int64_t blockBytes = 0, used = 0;
  /// The offset at which the scratch memory of this launch begins in its block.
  int64_t start = 0;
  std::vector<DevicePtr> outgrown;
  /// The collection of work for which scratch memory was last allocated.
  uint64_t collection = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_MIRROR_DEVICECONTEXT_H
