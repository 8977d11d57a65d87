//===- DeviceProgram.h - A repeated sequence of work ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Chooses among the ways to run a sequence: those that a cost model predicts to
// be good are timed in turn.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_DEVICEPROGRAM_H
#define TAI_LIB_RUNTIME_QUEUE_DEVICEPROGRAM_H

#include "GraphWay.h"
#include "KernelWay.h"
#include "PrefixedGraphs.h"

namespace mlir::tai::runtime {

/// A repeated sequence, and the ways to run it.
class DeviceQueue::Program {
public:
  Program(Device &device, Sequence sequence)
      : sequence(std::move(sequence)), device(device),
        schedules(device, this->sequence), prefixed(device) {}

  /// `same`: the slots are those of the last run.
  Status run(bool same, ProgramMode mode, const ProgramMaker &maker);
  /// The same after the launches of `prefix`.
  Status run(const Sequence &prefix, bool same, ProgramMode mode,
             const ProgramMaker &maker);
  /// Whether ways to run it have been set up.
  bool isPrepared() const {
    return !ways.empty() && !(chosen && current == ways.size());
  }
  std::string explain() const;
  bool uses(const Module &module) const;
  /// Its times in milliseconds, for RecordedLaunches::Outcome.
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
  /// The way that is being timed, or that has been chosen.
  size_t current = 0;
  bool chosen = false;
  /// The number of timed runs of the current way.
  int tries = 0;
  PrefixedGraphs prefixed;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_DEVICEPROGRAM_H
