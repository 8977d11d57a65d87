//===- CudaStreams.cpp - The order of our stream and others ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A launch that takes tensors of another library comes after what that has
// queued, and before what it queues next. That is asked for at every such
// launch, so it takes two calls of the driver each way, and none for the
// default stream.
//
//===----------------------------------------------------------------------===//

#include "CudaDevice.h"

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::cuda;

/// Ours is a blocking stream: the driver itself keeps it in order with the
/// default one.
static bool isDefault(uint64_t stream) {
  return stream == 0 || stream == kLegacyStream;
}

Status CudaDevice::waitForStream(uint64_t other) {
  // A kernel must not start before what has come in between.
  isAfterKernel = false;
  return isDefault(other) ? Status::success()
                          : order(reinterpret_cast<Stream>(other), stream);
}

Status CudaDevice::letStreamWait(uint64_t other) {
  return isDefault(other) ? Status::success()
                          : order(stream, reinterpret_cast<Stream>(other));
}

Status CudaDevice::order(Stream first, Stream second) {
  Status status = enter();
  if (!status)
    return status;
  // A stream waits for the place where the event was when it was told to: the
  // event can be used again at once.
  std::lock_guard<std::mutex> lock(orderMutex);
  if (!orderEvent)
    status = check(cu.eventCreate(&orderEvent, kEventNoTiming),
                   "no event can be made");
  if (status)
    status = check(cu.eventRecord(orderEvent, first),
                   "the stream of another library cannot be used");
  if (status)
    status = check(cu.streamWaitEvent(second, orderEvent, 0),
                   "the stream of another library cannot be used");
  return status;
}
