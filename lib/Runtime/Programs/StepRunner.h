//===- StepRunner.h - Queues the steps of a sequence ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_PROGRAMS_STEPRUNNER_H
#define TAI_LIB_RUNTIME_PROGRAMS_STEPRUNNER_H

#include "tai/Runtime/Device/FillRun.h"
#include "tai/Runtime/Programs/Sequence.h"

namespace mlir::tai::runtime::programs {

/// Queues the steps of a sequence in order, and consecutive fills together.
class StepRunner {
public:
  explicit StepRunner(Device &device) : device(device) {}
  Status run(const Sequence &sequence, const Step &step);
  Status runAll(const Sequence &sequence);
  /// Queues the fills that are pending. Must be called before other work is
  /// queued.
  Status finish();
  /// The number of separate pieces of work queued so far.
  size_t numPieces() const { return pieces; }

private:
  Device &device;
  FillRun fills;
  size_t pieces = 0;
};

} // namespace mlir::tai::runtime::programs

#endif // TAI_LIB_RUNTIME_PROGRAMS_STEPRUNNER_H
