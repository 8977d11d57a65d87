//===- DeviceContext.h - What a runtime keeps on its device -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The device of a runtime, the account of its memory, the state that device
// code uses for failures and output, and the code of each kernel there.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_MIRROR_DEVICECONTEXT_H
#define TAI_LIB_RUNTIME_MIRROR_DEVICECONTEXT_H

#include "DeviceWatch.h"
#include "LibraryKernels.h"
#include "tai/Runtime/Mirror/DeviceHost.h"
#include "tai/Runtime/Queue/DeviceQueue.h"
#include <atomic>
#include <map>
#include <mutex>

namespace mlir::tai::runtime {

class Mirror;

class DeviceContext {
public:
  /// With at most `limit` bytes there; 0 for what it has.
  DeviceContext(const DeviceServices &services, std::unique_ptr<Device> device,
                int64_t limit, std::shared_ptr<Profiler> profiler);
  ~DeviceContext();
  DeviceContext(const DeviceContext &) = delete;
  DeviceContext &operator=(const DeviceContext &) = delete;

  const DeviceServices &host() const { return services; }
  Device &get() const { return *device; }
  DeviceQueue &queue() const { return *device; }
  /// What lies between the queue and the device.
  WatchedDevice &watch() const { return *watched; }
  LibraryKernels &library() { return *libraryKernels; }

  /// Memory for a tree, or for another purpose; where there is none, the
  /// failure says who has it. Any thread.
  Status allocate(int64_t bytes, const std::string &owner, DevicePtr &memory);
  /// Memory that takes room where it is touched; see Device::reserve.
  Status reserve(int64_t bytes, const std::string &owner, DevicePtr &memory);
  void free(DevicePtr memory);
  /// The same for what work in order alone uses, such as values that tapes
  /// keep: the memory of one recording is that of the next one, at the same
  /// addresses.
  Status take(int64_t bytes, const std::string &owner, DevicePtr &memory);
  void giveBack(int64_t bytes, DevicePtr memory);
  /// The most that the program can have, and what is left of it for memory that
  /// is reserved, some of which has taken its room already.
  int64_t mostBytes() const;
  int64_t leftToReserved(int64_t taken);

  /// The state that device code uses, made at the first call.
  Status state(DevicePtr &memory);
  /// Device code may have left something there.
  void noteStateUsed() { stateUsed.store(true, std::memory_order_relaxed); }
  /// To be called when the device has been waited for: prints what device code
  /// has printed, and fails where it has failed.
  Status report();

  /// Work that is collected from now on uses the same scratch memory as that
  /// which was collected before, so that it can be the same work.
  void beginCollecting(bool isReplay) {
    // Launches that have been kept have begun with it.
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
  /// The same around what a tape records; see DeviceQueue.
  void beginRecording();
  void endRecording(bool isSwept);
  uint64_t numCollections() const {
    return collections.load(std::memory_order_relaxed);
  }

  /// Keeps the first failure of a call that could not say so itself.
  void note(Status status);
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

  // What each launch looks at.
  std::unique_ptr<DeviceQueue> device;
  std::atomic<bool> noted{false};
  std::atomic<bool> stateUsed{false};
  std::atomic<uint64_t> collections{0};

  DeviceServices services;
  WatchedDevice *watched;
  std::unique_ptr<LibraryKernels> libraryKernels;
  int64_t limit;
  std::mutex mutex;
  struct Holding {
    std::string owner;
    int64_t bytes;
  };
  std::map<DevicePtr, Holding> holdings;
  /// By their bytes, in the order in which they were given back.
  std::multimap<int64_t, DevicePtr> spare;
  int numRecordings = 0;
  int64_t held = 0;
  DevicePtr stateMemory = 0;
  Status failure;
};

/// Device memory that goes with its owner.
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
  /// For values that a tape keeps.
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

/// The device code of a kernel, once it has been loaded, and the trees that it
/// uses.
struct DeviceCode {
  explicit DeviceCode(std::shared_ptr<DeviceContext> context)
      : context(std::move(context)) {}

  struct Function {
    DeviceFunction *function;
    unsigned threads;
    /// That many blocks of so many threads run at a time.
    unsigned mostBlocks;
    /// Whether all launches have blocks of that size: the loop says so.
    bool hasSize;
    /// Finds better numbers, where they may be looked for.
    std::shared_ptr<BlockTrials> trials;
  };

  std::shared_ptr<DeviceContext> context;
  std::shared_ptr<const DeviceImage> image;
  std::unique_ptr<DeviceModule> module;
  std::vector<Function> functions;
  /// In the order of the trees of the kernel; some of them are changed by it.
  std::vector<Mirror *> mirrors, changed;
  std::vector<void *> bases;
  /// State of the storage for which these hold.
  std::atomic<uint64_t> epoch{0};
};

/// What a launch has on the device, kept for the launches after it.
struct DeviceLaunch {
  explicit DeviceLaunch(std::shared_ptr<DeviceContext> deviceContext)
      : context(std::move(deviceContext)),
        multiprocessors(context->get().limits().multiprocessors) {}
  ~DeviceLaunch();

  /// Zeroed memory. It is handed out from a block that is zeroed anew when it
  /// has been used up, which is in order with the launches that used it.
  Status scratch(int64_t bytes, DevicePtr &memory);
  /// Device memory that holds what the caller's does.
  Status array(void *host, int64_t bytes, bool written, DevicePtr &memory);
  /// The tree that has this base on the device, or null.
  Mirror *mirrorOf(const void *base) const {
    for (size_t i = 0; code && i < code->bases.size(); ++i)
      if (code->bases[i] == base)
        return code->mirrors[i];
    return nullptr;
  }
  /// Brings arrays back, and lets go of what the launch alone has used.
  Status finish();
  /// Whether there is nothing to do for a launch that has been queued.
  bool isFinished() const { return !usesState && !usesMemory; }

  std::shared_ptr<DeviceContext> context;
  const DeviceCode *code = nullptr;
  unsigned multiprocessors;
  bool usesState = false;
  /// The device was waited for after the last work was queued.
  bool waited = false;
  /// It has scratch memory or arrays.
  bool usesMemory = false;
  /// It has memory of another library, and may be kept.
  bool usesOthers = false;

private:
  struct Array {
    void *host;
    DevicePtr memory;
    int64_t bytes;
    bool written;
  };
  std::vector<Array> arrays;
  DevicePtr block = 0;
  int64_t blockBytes = 0, used = 0;
  /// Where this launch has begun in the block.
  int64_t start = 0;
  std::vector<DevicePtr> outgrown;
  /// The collection of work for which memory was last handed out.
  uint64_t collection = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_MIRROR_DEVICECONTEXT_H
