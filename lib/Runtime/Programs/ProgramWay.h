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

/// A way to run a sequence of launches on the device: as a graph, or as a
/// kernel.
class Way {
public:
  Way(Device &device, ProgramMode mode, double predicted)
      : mode(mode), predicted(predicted), device(device) {}
  Way(const Way &) = delete;
  Way &operator=(const Way &) = delete;
  virtual ~Way() = default;

  const ProgramMode mode;
  /// The predicted and the measured time of a run in milliseconds; negative if
  /// not measured yet.
  double predicted, measured = -1;
  /// The reason why this way to run a sequence cannot be used; empty if it can.
  std::string refused;
  /// The compilation of the way's code on another thread, or null.
  std::unique_ptr<ProgramJob> job;
  /// The predicted time to compile the code of this way; negative if not known.
  double compileSeconds = -1;
  /// The number of trial runs of this way so far, and a flag that tells whether
  /// the trial is over.
  int tries = 0;
  bool isTried = false;

  virtual bool isGraph() const = 0;
  /// True if this way to run a sequence uses programmatic dependent launch.
  virtual bool overlaps() const { return false; }
  /// True if this way to run a sequence runs chains of launches in tiles
  /// (ranges of iterations).
  virtual bool hasTiles() const { return false; }

  /// True if this way to run a sequence needs code that does not exist yet:
  /// then plan() describes the code, and adopt() loads it.
  virtual bool needsCode() const { return false; }
  virtual Status plan(ProgramPlan &plan) {
    (void)plan;
    return Status::success();
  }
  virtual Status adopt(const DeviceImage &image) {
    (void)image;
    return Status::success();
  }
  /// Notes that the parameter slots of the sequence have changed.
  void noteChange() { isCurrent = false; }
  /// Updates the graph or program to the current parameter slots of the
  /// sequence.
  Status makeCurrent();
  /// Runs the sequence in this way, outside of any other graph.
  virtual Status launch() = 0;
  /// Prepares this way to run a sequence for a call of runSteps.
  virtual Status prepareSteps() = 0;
  /// Queues the work of the sequence as part of a graph that is being captured.
  virtual Status runSteps(StepRunner &runner) = 0;

  /// Describe, for a report, the launches that this way to run a sequence
  /// makes, and the times of the steps of its last run.
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
