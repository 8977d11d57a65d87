//===- ProgramWay.h - One way to run a sequence -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_PROGRAMS_PROGRAMWAY_H
#define TAI_LIB_RUNTIME_PROGRAMS_PROGRAMWAY_H

#include "StepRunner.h"
#include "tai/Runtime/Programs/ProgramPlan.h"

namespace mlir::tai::runtime::programs {

/// The representation of a sequence on the device: a graph, or a kernel.
class Way {
public:
  Way(Device &device, ProgramMode mode, double predicted)
      : mode(mode), predicted(predicted), device(device) {}
  Way(const Way &) = delete;
  Way &operator=(const Way &) = delete;
  virtual ~Way() = default;

  const ProgramMode mode;
  /// Predicted and measured time in milliseconds; negative if not measured yet.
  double predicted, measured = -1;
  /// Why the way cannot be used; empty if it can.
  std::string refused;
  /// The compilation of the way's code on another thread, or null.
  std::unique_ptr<ProgramJob> job;
  /// The predicted time to compile the way's code; negative if not known.
  double compileSeconds = -1;
  /// The number of trial runs so far, and whether the trial is over.
  int tries = 0;
  bool isTried = false;

  virtual bool isGraph() const = 0;
  /// Whether the way uses programmatic dependent launch.
  virtual bool overlaps() const { return false; }
  /// Whether the way runs chains of launches in tiles.
  virtual bool hasTiles() const { return false; }

  /// Whether the way needs code that does not exist yet: then plan() describes
  /// the code, and adopt() loads it.
  virtual bool needsCode() const { return false; }
  virtual Status plan(ProgramPlan &plan) {
    (void)plan;
    return Status::success();
  }
  virtual Status adopt(const DeviceImage &image) {
    (void)image;
    return Status::success();
  }
  /// Notes that the slots of the sequence have changed.
  void noteChange() { isCurrent = false; }
  /// Updates the way to the current slots.
  Status makeCurrent();
  /// Runs the sequence in this way, outside of any other graph.
  virtual Status launch() = 0;
  /// Prepares the way for runSteps.
  virtual Status prepareSteps() = 0;
  /// Queues the work of the way as part of a graph that is being captured.
  virtual Status runSteps(StepRunner &runner) = 0;

  /// Describe the composition of the way, and the times of the steps of its
  /// last run.
  virtual std::string describe() const = 0;
  virtual std::string explainClocks() const { return ""; }

protected:
  virtual Status update() = 0;

  Device &device;

private:
  bool isCurrent = false;
};

inline Status Way::makeCurrent() {
  if (isCurrent)
    return Status::success();
  Status status = update();
  isCurrent = bool(status);
  return status;
}

} // namespace mlir::tai::runtime::programs

#endif // TAI_LIB_RUNTIME_PROGRAMS_PROGRAMWAY_H
