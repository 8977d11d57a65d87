//===- ProgramWay.h - One way to run a sequence -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_PROGRAMWAY_H
#define TAI_LIB_RUNTIME_QUEUE_PROGRAMWAY_H

#include "StepRunner.h"

namespace mlir::tai::runtime {

/// What stands for a sequence on the device: a graph, or a kernel.
class DeviceQueue::Way {
public:
  Way(Device &device, ProgramMode mode, double predicted)
      : mode(mode), predicted(predicted), device(device) {}
  Way(const Way &) = delete;
  Way &operator=(const Way &) = delete;
  virtual ~Way() = default;

  const ProgramMode mode;
  /// By the model, and as measured: milliseconds. Negative for not yet.
  double predicted, measured = -1;
  /// Why it cannot be taken.
  std::string refused;
  bool isReady = false;

  virtual bool isGraph() const = 0;
  /// Whether its launches wait by themselves.
  virtual bool overlaps() const { return false; }
  /// Whether it runs chains in tiles.
  virtual bool hasTiles() const { return false; }

  /// Makes it, for the first time.
  virtual Status prepare() = 0;
  /// The sequence has other slots now.
  void noteChange() { isCurrent = false; }
  /// Makes it hold the present slots.
  Status makeCurrent();
  /// Runs it, by itself.
  virtual Status launch() = 0;
  /// Makes it ready for runSteps.
  virtual Status prepareSteps() = 0;
  /// Queues its work behind other steps, which a graph records.
  virtual Status runSteps(StepRunner &runner) = 0;

  /// What it consists of, and where the time of its last run went.
  virtual std::string describe() const = 0;
  virtual std::string explainClocks() const { return ""; }

protected:
  virtual Status update() = 0;

  Device &device;

private:
  bool isCurrent = false;
};

inline Status DeviceQueue::Way::makeCurrent() {
  if (isCurrent)
    return Status::success();
  Status status = update();
  isCurrent = bool(status);
  return status;
}

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_PROGRAMWAY_H
