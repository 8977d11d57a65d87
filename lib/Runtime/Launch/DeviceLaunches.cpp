//===- DeviceLaunches.cpp - Kernels that run on a device ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/DeviceLaunches.h"
#include "tai/Runtime/Device/BlockTrial.h"
#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include <algorithm>

using namespace mlir::tai::runtime;

/// True if launches of the kernel may change the contents of the tree.
static bool mayChange(const Kernel &kernel, const Tree &tree) {
  const std::vector<Access> &summary = kernel.summary();
  // Adjoints and other derived kernels have no summary of their accesses, so
  // they may change any tree.
  if (summary.empty())
    return true;
  return std::any_of(summary.begin(), summary.end(), [&](const Access &access) {
    return access.kind != AccessKind::Read && &access.field->tree() == &tree;
  });
}

/// The number of threads that the registers of a function and the user's limit
/// allow.
static unsigned mostBlockThreads(const Device &device,
                                 const DeviceFunction &function,
                                 const Options &options) {
  unsigned most = device.mostThreads(function);
  return options.mostBlockThreads > 0
             ? std::min(most, static_cast<unsigned>(options.mostBlockThreads))
             : most;
}

/// Makes trials for the sizes of blocks that are worth a try; null if only the
/// usual size is possible.
static std::shared_ptr<BlockTrials>
makeTrials(const Device &device, const DeviceCode::Function &function,
           unsigned mostThreads, const KeptChoices &kept, std::string key) {
  std::vector<BlockTrial::Size> sizes{{function.threads, function.mostBlocks}};
  for (unsigned threads : {64u, 128u, 512u, 1024u})
    if (threads != function.threads && threads <= mostThreads)
      if (unsigned blocks = device.residentBlocks(*function.function, threads))
        sizes.push_back({threads, blocks});
  // With kAnyBlocks, the number of blocks follows the number of iterations, and
  // blocks start in the order of the memory that they access.
  for (unsigned threads : {128u, function.threads})
    if (threads <= mostThreads)
      sizes.push_back({threads, BlockTrial::kAnyBlocks});
  if (sizes.size() == 1)
    return nullptr;
  return std::make_shared<BlockTrials>(std::move(sizes), kept, std::move(key));
}

/// The key under which other processes with an equal device find the size of
/// blocks chosen for a function.
static std::string keyOf(const DeviceImage &image, const std::string &function,
                         const Device &device) {
  if (image.key.empty())
    return "";
  return image.key + "\n" + function + "\n" + device.name() + "\n" +
         device.target() + "\n" +
         std::to_string(device.limits().multiprocessors);
}

/// Loads device code of a kernel and finds its functions.
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

/// Loads device code of a kernel and finds its functions. An image from the
/// cache that the device refuses is compiled anew, once.
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
  // The host code of the kernel is not compiled anew and refers to device
  // functions by number, so both images must list the same functions.
  if (fresh->functions != image->functions)
    return status;
  image = std::move(fresh);
  return loadCode(device, *image, module, functions);
}

Status DeviceLaunches::load(Kernel &kernel, uint64_t epoch) {
  Kernel::Lock lock(kernel.section);
  if (lock.isAgain())
    return lock.check();
  std::shared_ptr<DeviceCode> &code = kernel.deviceCode;
  // Another thread may have loaded the device code meanwhile.
  if (code && code->epoch == epoch && code->image == kernel.info.image)
    return Status::success();
  kernel.prepared.state.store(0, std::memory_order_release);
  if (!code || code->image != kernel.info.image) {
    auto loaded = std::make_shared<DeviceCode>(devices.shared());
    Device &target = *devices.device();
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
      // The usual block size: enough threads to hide the latency of memory, and
      // few enough that registers do not limit the number of resident blocks.
      constexpr unsigned usualThreads = 256;
      unsigned wanted = options.blockThreads > 0
                            ? static_cast<unsigned>(options.blockThreads)
                            : usualThreads;
      unsigned said = loaded->image->blockSize(i);
      entry.hasSize = said > 0;
      unsigned most = mostBlockThreads(target, *entry.function, options);
      entry.threads = std::min(entry.hasSize ? said : wanted, most);
      entry.mostBlocks =
          std::max(target.residentBlocks(*entry.function, entry.threads), 1u);
      if (!entry.hasSize && options.blockThreads <= 0 && options.triesBlocks)
        entry.trials = makeTrials(target, entry, most, blockSizes,
                                  keyOf(*loaded->image, name, target));
      loaded->functions.push_back(entry);
    }
    code = std::move(loaded);
  }
  devices.profiler().noteBytes(code->image->functions, kernel.touchedBytes());
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

Status DeviceLaunches::enter(Launch &launch, Kernel &kernel) {
  Status status = devices.get()->take();
  if (!status)
    return status;
  if (!launch.onDevice)
    launch.onDevice = std::make_unique<DeviceLaunch>(devices.shared());
  DeviceLaunch &onDevice = *launch.onDevice;
  if (!kernel.info.image) {
    onDevice.code = nullptr;
    for (const TreePtr &tree : kernel.info.trees)
      if (mayChange(kernel, *tree))
        (void)tree->writable();
      else
        (void)tree->readable();
    return devices.get()->take();
  }
  uint64_t epoch = kernel.boundEpoch.load(std::memory_order_relaxed);
  const DeviceCode *code = kernel.deviceCode.get();
  if (__builtin_expect(!code || code->epoch != epoch ||
                           code->image != kernel.info.image,
                       false)) {
    status = load(kernel, epoch);
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

void DeviceLaunches::leave(Launch &launch) {
  DeviceLaunch &onDevice = *launch.onDevice;
  if (!onDevice.code)
    return;
  for (Mirror *mirror : onDevice.code->changed)
    mirror->deviceWrites();
  Status status = onDevice.finish();
  if (onDevice.usesState) {
    devices.get()->noteStateUsed();
    // In debug mode, the host waits for each launch, so that its failures are
    // not reported by a later wait.
    if (status && options.instruments.debug && !onDevice.waited) {
      status = devices.device()->synchronize();
      onDevice.waited = true;
    }
    if (status && onDevice.waited)
      status = devices.get()->report();
  }
  if (!status)
    launch.fail(std::move(status));
  onDevice.code = nullptr;
}
