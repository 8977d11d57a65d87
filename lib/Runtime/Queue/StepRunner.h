//===- StepRunner.h - Queues the steps of a sequence ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_STEPRUNNER_H
#define TAI_LIB_RUNTIME_QUEUE_STEPRUNNER_H

#include "FillRun.h"
#include "Sequence.h"

namespace mlir::tai::runtime {

/// Queues steps one after another, and fills that follow one another together.
class DeviceQueue::StepRunner {
public:
  explicit StepRunner(Device &device) : device(device) {}
  Status run(const Sequence &sequence, const Step &step);
  Status runAll(const Sequence &sequence);
  /// Runs all steps, with nothing before or after them.
  static Status runAlone(Device &device, const Sequence &sequence);
  /// Runs what has been held back: before anything else is queued.
  Status finish();
  /// How many pieces of work that has been.
  size_t numPieces() const { return pieces; }

private:
  Device &device;
  FillRun fills;
  size_t pieces = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_STEPRUNNER_H
