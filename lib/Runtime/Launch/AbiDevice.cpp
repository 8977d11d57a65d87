//===- AbiDevice.cpp - Launches on a device -------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The part of Abi.h by which the host's part of a kernel queues work, and what
// the runtime does before and after it. The way of a launch takes no lock and
// allocates nothing.
//
//===----------------------------------------------------------------------===//

#include "../Device/BlockTrial.h"
#include "../Mirror/Mirror.h"
#include "Launch.h"
#include "tai/ABI/Abi.h"
#include <algorithm>
#include <cstring>

using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// The device of a runtime
//===----------------------------------------------------------------------===//

Status Runtime::useDevice(std::unique_ptr<Device> opened, int64_t memoryLimit) {
  if (!trees.empty())
    return Status::failure(StatusCode::Usage,
                           "the device must be chosen before the first field "
                           "is made");
  hot.launch = nullptr;
  hot.thread.store(nullptr, std::memory_order_relaxed);
  launches.clear();
  freeLaunches.clear();
  spareLaunch.store(nullptr, std::memory_order_relaxed);
  storageChanged();
  device = opened ? std::make_shared<DeviceContext>(*this, std::move(opened),
                                                    memoryLimit, profiler)
                  : nullptr;
  return Status::success();
}

Device *Runtime::getDevice() const { return device ? &device->get() : nullptr; }

DeviceQueue *Runtime::getDeviceQueue() const {
  return device ? &device->queue() : nullptr;
}

Status Runtime::synchronize() {
  if (!device)
    return Status::success();
  Status status = device->get().synchronize();
  if (status)
    status = device->take();
  return status ? device->report() : std::move(status);
}

void Runtime::noteFailure(Status status) {
  if (!status && device)
    device->note(std::move(status));
}

Status Runtime::takeNoted() { return device->take(); }

Status Runtime::deviceAddress(const Tree &tree, int64_t offset,
                              void *&address) {
  settleZeros();
  Mirror *mirror = tree.mirror();
  if (!mirror)
    return Status::failure(StatusCode::Usage,
                           "tree '" + tree.name() + "' is not on a device");
  DevicePtr memory = 0;
  Status status = mirror->toDevice();
  if (status)
    status = mirror->allocate(memory);
  address = reinterpret_cast<void *>(memory + static_cast<DevicePtr>(offset));
  return status;
}

//===----------------------------------------------------------------------===//
// Around the code of a kernel
//===----------------------------------------------------------------------===//

/// Whether the launches of the kernel may change the tree.
static bool mayChange(const Kernel &kernel, const Tree &tree) {
  const std::vector<Access> &summary = kernel.summary();
  // Adjoints and the like come without one.
  if (summary.empty())
    return true;
  return std::any_of(summary.begin(), summary.end(), [&](const Access &access) {
    return access.kind != AccessKind::Read && &access.field->tree() == &tree;
  });
}

/// What the registers of a function and the user leave room for.
static unsigned mostBlockThreads(const Device &device,
                                 const DeviceFunction &function,
                                 const Options &options) {
  unsigned most = device.mostThreads(function);
  return options.mostBlockThreads > 0
             ? std::min(most, static_cast<unsigned>(options.mostBlockThreads))
             : most;
}

/// Sizes of blocks that are worth a try besides the usual one; none where
/// there is no other.
static std::shared_ptr<BlockTrials>
makeTrials(const Device &device, const DeviceCode::Function &function,
           unsigned mostThreads, const KeptBlockSizes &kept, std::string key) {
  std::vector<BlockTrial::Size> sizes{{function.threads, function.mostBlocks}};
  for (unsigned threads : {64u, 128u, 512u, 1024u})
    if (threads != function.threads && threads <= mostThreads)
      if (unsigned blocks = device.residentBlocks(*function.function, threads))
        sizes.push_back({threads, blocks});
  // As many blocks as there is work for, which come in order of the memory.
  for (unsigned threads : {128u, function.threads})
    if (threads <= mostThreads)
      sizes.push_back({threads, BlockTrial::kAnyBlocks});
  if (sizes.size() == 1)
    return nullptr;
  return std::make_shared<BlockTrials>(std::move(sizes), kept, std::move(key));
}

/// What another process knows a function by that runs on such a device.
static std::string keyOf(const DeviceImage &image, const std::string &function,
                         const Device &device) {
  if (image.key.empty())
    return "";
  return image.key + "\n" + function + "\n" + device.name() + "\n" +
         device.target() + "\n" +
         std::to_string(device.limits().multiprocessors);
}

/// Loads code and finds its functions.
static Status loadCode(Device &device, const DeviceImage &image,
                       std::unique_ptr<DeviceModule> &module,
                       std::vector<DeviceFunction *> &functions) {
  functions.clear();
  Status status = device.load(image, module);
  for (const std::string &name : image.functions) {
    DeviceFunction *function = nullptr;
    if (status)
      status = device.find(*module, name, function);
    functions.push_back(function);
  }
  return status;
}

/// The same; what came from the cache and is not taken is compiled anew, once.
static Status loadOrMakeAgain(Device &device,
                              std::shared_ptr<const DeviceImage> &image,
                              std::unique_ptr<DeviceModule> &module,
                              std::vector<DeviceFunction *> &functions) {
  Status status = loadCode(device, *image, module, functions);
  if (status || !image->makeAgain || status.code() != StatusCode::Internal)
    return status;
  auto fresh = std::make_shared<DeviceImage>();
  Status made = image->makeAgain(*fresh);
  if (!made)
    return made;
  // The host's part, which goes by numbers, stays.
  if (fresh->functions != image->functions)
    return status;
  image = std::move(fresh);
  return loadCode(device, *image, module, functions);
}

Status Runtime::loadOnDevice(Kernel &kernel, uint64_t epoch) {
  std::lock_guard<std::recursive_mutex> lock(kernel.mutex);
  std::shared_ptr<DeviceCode> &code = kernel.deviceCode;
  // Another thread may have come first.
  if (code && code->epoch == epoch && code->image == kernel.info.image)
    return Status::success();
  kernel.prepared.state.store(0, std::memory_order_release);
  if (!code || code->image != kernel.info.image) {
    auto loaded = std::make_shared<DeviceCode>(device);
    Device &target = device->get();
    std::vector<DeviceFunction *> functions;
    Status status =
        loadOrMakeAgain(target, kernel.info.image, loaded->module, functions);
    if (!status) {
      std::string message =
          "kernel '" + kernel.name() + "': " + status.message();
      if (status.code() == StatusCode::Internal && kernel.info.provider)
        message = kernel.info.provider->explainRefusal(message);
      return Status::failure(status.code(), std::move(message));
    }
    loaded->image = kernel.info.image;
    for (size_t i = 0; i < functions.size(); ++i) {
      const std::string &name = loaded->image->functions[i];
      DeviceCode::Function entry{};
      entry.function = functions[i];
      // Enough to hide the time of memory, and few enough that registers do
      // not limit how many blocks there are.
      constexpr unsigned usualThreads = 256;
      unsigned wanted = opts.blockThreads > 0
                            ? static_cast<unsigned>(opts.blockThreads)
                            : usualThreads;
      unsigned said = loaded->image->blockSize(i);
      entry.hasSize = said > 0;
      unsigned most = mostBlockThreads(target, *entry.function, opts);
      entry.threads = std::min(entry.hasSize ? said : wanted, most);
      entry.mostBlocks =
          std::max(target.residentBlocks(*entry.function, entry.threads), 1u);
      if (!entry.hasSize && opts.blockThreads <= 0 && !opts.deterministic)
        entry.trials = makeTrials(target, entry, most, blockSizes,
                                  keyOf(*loaded->image, name, target));
      loaded->functions.push_back(entry);
    }
    code = std::move(loaded);
  }
  profiler->noteBytes(code->image->functions, kernel.touchedBytes());
  code->mirrors.clear();
  code->changed.clear();
  code->bases.clear();
  for (const TreePtr &tree : kernel.info.trees) {
    DevicePtr memory = 0;
    Status status = tree->mirror()->allocate(memory);
    if (!status)
      return status;
    code->mirrors.push_back(tree->mirror());
    code->bases.push_back(reinterpret_cast<void *>(memory));
    if (mayChange(kernel, *tree))
      code->changed.push_back(tree->mirror());
  }
  code->epoch = epoch;
  return Status::success();
}

Status Runtime::enterDevice(Launch &launch, Kernel &kernel) {
  Status status = device->take();
  if (!status)
    return status;
  if (!launch.onDevice)
    launch.onDevice = std::make_unique<DeviceLaunch>(device);
  DeviceLaunch &onDevice = *launch.onDevice;
  if (!kernel.info.image) {
    onDevice.code = nullptr;
    for (const TreePtr &tree : kernel.info.trees)
      if (mayChange(kernel, *tree))
        (void)tree->writable();
      else
        (void)tree->readable();
    return device->take();
  }
  uint64_t epoch = kernel.boundEpoch.load(std::memory_order_relaxed);
  const DeviceCode *code = kernel.deviceCode.get();
  if (__builtin_expect(!code || code->epoch != epoch ||
                           code->image != kernel.info.image,
                       false)) {
    status = loadOnDevice(kernel, epoch);
    if (!status)
      return status;
    code = kernel.deviceCode.get();
  }
  for (Mirror *mirror : code->mirrors)
    if (__builtin_expect(!mirror->onDevice(), false)) {
      status = mirror->toDevice();
      if (!status)
        return status;
    }
  onDevice.code = code;
  onDevice.usesState = onDevice.waited = false;
  launch.trees = const_cast<void **>(code->bases.data());
  return status;
}

void Runtime::leaveDevice(Launch &launch) {
  DeviceLaunch &onDevice = *launch.onDevice;
  if (!onDevice.code)
    return;
  for (Mirror *mirror : onDevice.code->changed)
    mirror->deviceWrites();
  Status status = onDevice.finish();
  if (onDevice.usesState) {
    device->noteStateUsed();
    // Otherwise what happened is said when somebody waits.
    if (status && opts.debug && !onDevice.waited) {
      status = device->get().synchronize();
      onDevice.waited = true;
    }
    if (status && onDevice.waited)
      status = device->report();
  }
  if (!status)
    launch.fail(std::move(status));
  onDevice.code = nullptr;
}

//===----------------------------------------------------------------------===//
// What the host's part of a kernel calls
//===----------------------------------------------------------------------===//

/// Null after a failure: what is left of the kernel does nothing then.
static DeviceLaunch *working(Launch &launch) {
  if (__builtin_expect(launch.hasFailed(), false))
    return nullptr;
  DeviceLaunch *onDevice = launch.onDevice.get();
  if (__builtin_expect(!onDevice || !onDevice->code, false)) {
    launch.fail(Status::failure(StatusCode::Internal,
                                "code for a device was launched without one"));
    return nullptr;
  }
  return onDevice;
}

/// Keeps a failure. Returns true if there was one.
static bool failed(Launch &launch, Status status) {
  if (__builtin_expect(status.ok(), true))
    return false;
  launch.fail(std::move(status));
  return true;
}

static LaunchShape shapeOf(BlockTrial::Size function, bool hasSize,
                           int64_t iterations, unsigned multiprocessors) {
  LaunchShape shape;
  shape.threads = function.threads;
  shape.blocks = function.mostBlocks;
  if (iterations < 0)
    return shape;
  if (!hasSize && iterations == 1) {
    shape.threads = shape.blocks = 1;
    return shape;
  }
  auto blocksOf = [&](unsigned threads) {
    return (iterations + threads - 1) / threads;
  };
  // Few iterations are spread over all of the device, by whole warps.
  constexpr unsigned warp = 32, leastThreads = 64;
  while (!hasSize && shape.threads >= 2 * leastThreads &&
         blocksOf(shape.threads) < int64_t(multiprocessors))
    shape.threads = (shape.threads / 2 + warp - 1) / warp * warp;
  if (!hasSize && iterations < int64_t(shape.threads))
    shape.threads =
        std::min(shape.threads,
                 static_cast<unsigned>((iterations + warp - 1) / warp * warp));
  // Of smaller blocks as many threads run at a time.
  int64_t most = function.mostBlocks == BlockTrial::kAnyBlocks
                     ? function.mostBlocks
                     : int64_t(function.mostBlocks) * function.threads /
                           std::max(shape.threads, 1u);
  shape.blocks = static_cast<unsigned>(
      std::clamp<int64_t>(blocksOf(shape.threads), 1, most));
  return shape;
}

extern "C" void tai_rt_device_launch(TaiFrame *frame, int32_t number,
                                     int64_t iterations, const uint64_t *slots,
                                     int32_t count) {
  Launch &launch = launchOf(frame);
  DeviceLaunch *onDevice = working(launch);
  if (!onDevice || iterations == 0)
    return;
  if (__builtin_expect(launch.owner().interruptRequested(), false)) {
    launch.fail(Status::failure(StatusCode::Interrupted, "interrupted"));
    return;
  }
  const DeviceCode::Function &function =
      onDevice->code->functions[static_cast<size_t>(number)];
  onDevice->waited = false;
  DeviceQueue &queue = onDevice->context->queue();
  auto shapeWith = [&](BlockTrial::Size size) {
    return shapeOf(size, function.hasSize, iterations,
                   onDevice->multiprocessors);
  };
  auto launchWith = [&](BlockTrial::Size size) {
    return queue.launch(*function.function, shapeWith(size), slots, count);
  };
  bool isLarge = function.trials && iterations >= BlockTrial::kLeastIterations;
  if (__builtin_expect(!isLarge, true)) {
    failed(launch, launchWith({function.threads, function.mostBlocks}));
    return;
  }
  BlockTrial &trial = function.trials->of(iterations);
  if (trial.hasEnded())
    // A sequence is known by the shapes of its launches.
    failed(launch, launchWith(trial.best()));
  else if (!failed(launch, queue.interrupt()))
    failed(launch, trial.run(queue, iterations, [&](BlockTrial::Size size) {
      return queue.launchNow(*function.function, shapeWith(size), slots, count);
    }));
}

extern "C" void *tai_rt_device_scratch(TaiFrame *frame, int64_t bytes) {
  Launch &launch = launchOf(frame);
  DevicePtr memory = 0;
  if (DeviceLaunch *onDevice = working(launch))
    failed(launch, onDevice->scratch(bytes, memory));
  return reinterpret_cast<void *>(memory);
}

extern "C" void tai_rt_device_fetch(TaiFrame *frame, void *to, const void *from,
                                    int64_t bytes) {
  Launch &launch = launchOf(frame);
  DeviceLaunch *onDevice = working(launch);
  if (!onDevice ||
      failed(launch, onDevice->context->get().copyOut(
                         to, reinterpret_cast<DevicePtr>(from), bytes))) {
    // What is left of the kernel must not count on what was there.
    std::memset(to, 0, static_cast<size_t>(bytes));
    return;
  }
  onDevice->waited = true;
}

extern "C" void *tai_rt_device_array(TaiFrame *frame, void *array,
                                     int64_t bytes, int32_t written) {
  Launch &launch = launchOf(frame);
  DevicePtr memory = 0;
  if (DeviceLaunch *onDevice = working(launch))
    failed(launch, onDevice->array(array, bytes, written != 0, memory));
  return reinterpret_cast<void *>(memory);
}

extern "C" void *tai_rt_device_state(TaiFrame *frame) {
  Launch &launch = launchOf(frame);
  DevicePtr memory = 0;
  if (DeviceLaunch *onDevice = working(launch)) {
    onDevice->usesState = true;
    failed(launch, onDevice->context->state(memory));
  }
  return reinterpret_cast<void *>(memory);
}

extern "C" void tai_rt_device_activates(TaiFrame *frame, void *tree,
                                        int32_t removes) {
  DeviceLaunch *onDevice = working(launchOf(frame));
  Mirror *mirror = onDevice ? onDevice->mirrorOf(tree) : nullptr;
  if (!mirror || !mirror->sparse())
    return;
  mirror->deviceWrites();
  mirror->sparse()->deviceActivates(removes != 0);
}
