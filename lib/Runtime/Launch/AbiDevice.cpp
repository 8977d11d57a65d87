//===- AbiDevice.cpp - Launches on a device -------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The functions of Abi.h by which host code of a kernel queues work. The path
// of a launch takes no lock and does not allocate.
//
//===----------------------------------------------------------------------===//

#include "tai/ABI/Abi.h"
#include "tai/Runtime/Device/BlockTrial.h"
#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include <algorithm>
#include <cstring>

using namespace mlir::tai::runtime;

/// Returns the device state of the launch, or null after a failure: the rest of
/// the kernel then has no effect.
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

/// Fails the launch if `status` is a failure, and returns true in that case.
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
  shape.canShrink = !hasSize;
  if (iterations < 0)
    return shape;
  if (!hasSize && iterations == 1) {
    shape.threads = shape.blocks = 1;
    return shape;
  }
  auto blocksOf = [&](unsigned threads) {
    return (iterations + threads - 1) / threads;
  };
  // With few iterations, blocks are shrunk, in whole warps, to give each
  // multiprocessor a block.
  constexpr unsigned warp = 32, leastThreads = 64;
  while (!hasSize && shape.threads >= 2 * leastThreads &&
         blocksOf(shape.threads) < int64_t(multiprocessors))
    shape.threads = (shape.threads / 2 + warp - 1) / warp * warp;
  if (!hasSize && iterations < int64_t(shape.threads))
    shape.threads =
        std::min(shape.threads,
                 static_cast<unsigned>((iterations + warp - 1) / warp * warp));
  // If blocks have shrunk, the grid may have more of them, for the same number
  // of resident threads.
  int64_t most = function.mostBlocks == BlockTrial::kAnyBlocks
                     ? function.mostBlocks
                     : int64_t(function.mostBlocks) * function.threads /
                           std::max(shape.threads, 1u);
  shape.blocks = static_cast<unsigned>(
      std::clamp<int64_t>(blocksOf(shape.threads), 1, most));
  return shape;
}

static void launchOnDevice(Launch &launch, int32_t number, int64_t iterations,
                           const uint64_t *slots, int32_t count) {
  DeviceLaunch *onDevice = working(launch);
  if (!onDevice || iterations == 0)
    return;
  if (__builtin_expect(launch.owner().launcher().interruptRequested(), false)) {
    launch.fail(failAsInterrupted());
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
    // The queue recognizes a repeated sequence by the shapes of its launches,
    // so launches with trial shapes stay outside of the sequence.
    failed(launch, launchWith(trial.best()));
  else if (!failed(launch, queue.interrupt()))
    failed(launch, trial.run(queue, iterations, [&](BlockTrial::Size size) {
      return queue.launchNow(*function.function, shapeWith(size), slots, count);
    }));
}

extern "C" void tai_rt_device_launch(TaiFrame *frame, int32_t number,
                                     int64_t iterations, const uint64_t *slots,
                                     int32_t count) {
  orFail(frame, [&] {
    launchOnDevice(launchOf(frame), number, iterations, slots, count);
  });
}

/// Returns the device memory that `find` stores in its second argument, or null
/// after a failure.
template <typename Find>
static void *findMemory(TaiFrame *frame, const Find &find) {
  return orFail(frame, static_cast<void *>(nullptr), [&] {
    Launch &launch = launchOf(frame);
    DevicePtr memory = 0;
    if (DeviceLaunch *onDevice = working(launch))
      failed(launch, find(*onDevice, memory));
    return reinterpret_cast<void *>(memory);
  });
}

extern "C" void *tai_rt_device_scratch(TaiFrame *frame, int64_t bytes) {
  return findMemory(frame, [&](DeviceLaunch &onDevice, DevicePtr &memory) {
    return onDevice.scratch(bytes, memory);
  });
}

extern "C" void tai_rt_device_fetch(TaiFrame *frame, void *to, const void *from,
                                    int64_t bytes) {
  bool isFetched = orFail(frame, false, [&] {
    Launch &launch = launchOf(frame);
    DeviceLaunch *onDevice = working(launch);
    if (!onDevice ||
        failed(launch, onDevice->context->get().copyOut(
                           to, reinterpret_cast<DevicePtr>(from), bytes)))
      return false;
    onDevice->waited = true;
    return true;
  });
  // After a failure, the rest of the kernel must not rely on the old contents
  // of the memory.
  if (!isFetched)
    std::memset(to, 0, static_cast<size_t>(bytes));
}

extern "C" void *tai_rt_device_array(TaiFrame *frame, void *array,
                                     int64_t bytes, int32_t written) {
  return findMemory(frame, [&](DeviceLaunch &onDevice, DevicePtr &memory) {
    return onDevice.array(array, bytes, written != 0, memory);
  });
}

extern "C" void *tai_rt_device_state(TaiFrame *frame) {
  return findMemory(frame, [&](DeviceLaunch &onDevice, DevicePtr &memory) {
    onDevice.usesState = true;
    return onDevice.context->state(memory);
  });
}

extern "C" void tai_rt_device_activates(TaiFrame *frame, void *tree,
                                        int32_t removes) {
  orFail(frame, [&] {
    DeviceLaunch *onDevice = working(launchOf(frame));
    Mirror *mirror = onDevice ? onDevice->mirrorOf(tree) : nullptr;
    if (!mirror || !mirror->sparse())
      return;
    mirror->deviceWrites();
    mirror->sparse()->deviceActivates(removes != 0);
  });
}
