//===- DeviceProgram.h - A sequence of work that comes again ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Chooses among the ways to run a sequence: those that a model takes for good
// are run in turn, and measured.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_DEVICEPROGRAM_H
#define TAI_LIB_RUNTIME_QUEUE_DEVICEPROGRAM_H

#include "GraphWay.h"
#include "KernelWay.h"
#include "PrefixedGraphs.h"

namespace mlir::tai::runtime {

/// A sequence that has come before, and the ways to run it.
class DeviceQueue::Program {
public:
  Program(Device &device, Sequence sequence)
      : sequence(std::move(sequence)), device(device),
        schedules(device, this->sequence), prefixed(device) {}

  /// `same`: with the slots of the last time.
  Status run(bool same, ProgramMode mode, const ProgramMaker &maker);
  /// The same behind a sequence that comes before it.
  Status run(const Sequence &prefix, bool same, ProgramMode mode,
             const ProgramMaker &maker);
  /// Whether there are ways to run it.
  bool isPrepared() const {
    return !ways.empty() && !(chosen && current == ways.size());
  }
  std::string explain() const;
  bool uses(const Module &module) const;
  /// What it takes, for those who collect recordings.
  void tellTimes(double &chosenMs, double &graphMs) const;

  Sequence sequence;

private:
  void listWays(ProgramMode wanted);
  void addWay(ProgramMode mode, const LaunchShape &shape);
  double predict(ProgramMode mode, const LaunchShape &shape) const;
  bool mayOverlapPay() const;
  Status prepare(Way &way);
  Status runTimed(Way &way);
  void noteRun(bool same);

  Device &device;
  StepSchedules schedules;
  ProgramMaker maker;
  OverlappingKernels overlapping;
  int runs = 0, changes = 0;
  std::vector<std::unique_ptr<Way>> ways;
  /// The way that is being tried, or that has been chosen.
  size_t current = 0;
  bool chosen = false;
  /// Times that the current way has been run while it is tried.
  int tries = 0;
  PrefixedGraphs prefixed;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_DEVICEPROGRAM_H
