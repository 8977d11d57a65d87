//===- StepRunner.cpp - Queues the steps of a sequence --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "StepRunner.h"
#include <new>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::programs;

Status StepRunner::run(const Sequence &sequence, const Step &step) {
  if (!step.isFill()) {
    Status status = finish();
    ++pieces;
    return status ? sequence.run(device, step) : std::move(status);
  }
  DeviceFill fill = sequence.fillOf(step);
  try {
    if (fills.add(fill))
      return Status::success();
    Status status = finish();
    (void)fills.add(fill);
    return status;
  } catch (const std::bad_alloc &) {
    Status status = finish();
    ++pieces;
    return status ? sequence.run(device, step) : std::move(status);
  }
}

/// Runs all steps. The runtime relies on each of them, such as the zeroing of
/// gradients: if memory runs out in a step, the steps after it still run.
Status StepRunner::runAll(const Sequence &sequence) {
  Status status;
  bool isOutOfMemory = false;
  for (const Step &step : sequence.steps)
    try {
      if (status)
        status = run(sequence, step);
    } catch (const std::bad_alloc &) {
      isOutOfMemory = true;
    }
  if (isOutOfMemory)
    throw std::bad_alloc();
  return status;
}

Status StepRunner::finish() {
  if (fills.get().empty())
    return Status::success();
  Status status = device.fillAll(fills.get());
  ++pieces;
  fills.clear();
  return status;
}
