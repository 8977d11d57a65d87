//===- DeviceProgram.h - A repeated sequence of work ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Chooses among the ways to run a sequence: those that a cost model predicts to
// be good are timed in turn. If programs are compiled in the background, the
// sequence runs as a graph meanwhile, and trials take a bounded share of the
// time.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_PROGRAMS_DEVICEPROGRAM_H
#define TAI_RUNTIME_PROGRAMS_DEVICEPROGRAM_H

#include "tai/Runtime/Device/KeptChoices.h"
#include "tai/Runtime/Programs/ProgramPlan.h"
#include "tai/Runtime/Programs/Sequence.h"
#include <chrono>
#include <optional>

namespace mlir::tai::runtime::programs {

class OverlappingKernels;
class PrefixedGraphs;
class StepSchedules;
class Way;

/// A repeated sequence, and the ways to run it.
class DeviceProgram {
public:
  /// The tools of the queue: `maker` compiles at once, `starter` in the
  /// background; each may be null.
  struct Tools {
    const ProgramMaker &maker;
    const ProgramStarter &starter;
    const KeptChoices &choices;
  };

  DeviceProgram(Device &device, Sequence sequence);
  ~DeviceProgram();

  /// Runs the sequence. `same` says that its parameter slots are the same as in
  /// the last run.
  Status run(bool same, ProgramMode mode, const Tools &tools);
  /// Runs the launches of `prefix`, and then the sequence.
  Status run(const Sequence &prefix, bool same, ProgramMode mode,
             const Tools &tools);
  /// True if a way to run the sequence is in use, or still to be tried.
  bool isPrepared() const { return used || hasTrials(); }
  std::string explain() const;
  bool uses(const Module &module) const;
  /// Sets the times of the chosen way and of a graph in milliseconds, for
  /// RecordedLaunches::Outcome; leaves the variables unchanged while trials go
  /// on.
  void tellTimes(double &chosenMs, double &graphMs) const;

  Sequence sequence;

private:
  using Clock = std::chrono::steady_clock;

  void listWays(ProgramMode wanted);
  void dropHopelessWays();
  void addWay(ProgramMode mode, const LaunchShape &shape);
  double predict(ProgramMode mode, const LaunchShape &shape) const;
  const Way *findGraph() const;
  Way *findFastest() const;
  bool mayOverlapPay() const;
  void begin(ProgramMode mode, const Tools &tools);
  bool hasTrials() const;
  Way *nextTrial();
  /// Loads the code of this way to run the program. Returns false if the code
  /// is still being made in the background, or cannot be made, which refuses
  /// the way.
  bool makeCode(Way &way);
  bool isWorthCompiling(Way &way) const;
  bool mayTry() const;
  Status tryWay(Way &way);
  Status runTimed(Way &way);
  Status runUsed();
  void refuse(Way &way, std::string why);
  void endTrial(Way &way);
  void use(Way *way);
  void noteRun(bool same);
  std::string choiceKey() const;

  Device &device;
  std::unique_ptr<StepSchedules> schedules;
  /// The function that compiles a program at once; null if programs are
  /// compiled in the background.
  ProgramMaker maker;
  ProgramStarter starter;
  KeptChoices choices;
  /// The way to run this sequence that an earlier process has chosen.
  std::optional<ProgramMode> keptChoice;
  /// True if steps of the current run have been queued on the device.
  bool hasStarted = false;
  std::unique_ptr<OverlappingKernels> overlapping;
  int runs = 0, changes = 0;
  /// The time of the second run of the sequence, and the time spent on trials
  /// since then.
  Clock::time_point begun;
  Clock::duration spent{};
  std::vector<std::unique_ptr<Way>> ways;
  /// The fastest way to run the sequence so far; null while its steps are
  /// launched one by one.
  Way *used = nullptr;
  std::unique_ptr<PrefixedGraphs> prefixed;
};

} // namespace mlir::tai::runtime::programs

#endif // TAI_RUNTIME_PROGRAMS_DEVICEPROGRAM_H
