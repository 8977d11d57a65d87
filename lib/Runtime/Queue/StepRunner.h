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

/// Queues steps in order, and consecutive fills together.
class DeviceQueue::StepRunner {
public:
  explicit StepRunner(Device &device) : device(device) {}
  Status run(const Sequence &sequence, const Step &step);
  Status runAll(const Sequence &sequence);
  /// Queues all steps of a sequence, and the fills that are pending then.
  static Status runAlone(Device &device, const Sequence &sequence);
  /// Queues pending fills; call before other work is queued.
  Status finish();
  /// The number of separate pieces of work so far.
  size_t numPieces() const { return pieces; }

private:
  Device &device;
  FillRun fills;
  size_t pieces = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_STEPRUNNER_H
