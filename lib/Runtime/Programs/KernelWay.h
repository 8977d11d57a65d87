//===- KernelWay.h - Sequences as one kernel --------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A table of steps, and a persistent kernel that executes it: all its threads
// run a step together, with a barrier before the next one. A barrier costs a
// fraction of a launch, less for fewer threads. When parameters change, the
// table is written again, and the kernel is recompiled only if they vary from
// step to step in a new way.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_PROGRAMS_KERNELWAY_H
#define TAI_LIB_RUNTIME_PROGRAMS_KERNELWAY_H

#include "ProgramWay.h"
#include "StepSchedules.h"

namespace mlir::tai::runtime::programs {

class KernelWay final : public Way {
public:
  /// `maker` compiles code at once if parameters vary in a new way. If it is
  /// null, the program then needs new code (needsCode), and cannot be used
  /// until adopt().
  KernelWay(Device &device, const Sequence &sequence, ProgramMode mode,
            double predicted, const ProgramMaker &maker,
            StepSchedules &schedules, const LaunchShape &shape)
      : Way(device, mode, predicted), sequence(sequence), maker(maker),
        schedules(schedules), shape(shape),
        usesTiles(mode == ProgramMode::Tiles) {}
  ~KernelWay() override;

  bool isGraph() const override { return false; }
  bool hasTiles() const override { return usesTiles; }
  bool needsCode() const override { return !function || isOutdated; }
  Status plan(ProgramPlan &plan) override;
  Status adopt(const DeviceImage &image) override;
  Status launch() override;
  Status prepareSteps() override { return makeCurrent(); }
  Status runSteps(StepRunner &runner) override;
  std::string describe() const override;
  std::string explainClocks() const override;

private:
  Status update() override;
  Status updateTable(const std::vector<uint64_t> &rows);

  const Sequence &sequence;
  const ProgramMaker &maker;
  StepSchedules &schedules;
  LaunchShape shape;
  bool usesTiles;
  std::unique_ptr<DeviceModule> module;
  DeviceFunction *function = nullptr;
  DevicePtr table = 0;
  int64_t tableBytes = 0;
  /// Device memory for the time stamps (number of steps + 1); 0 if steps are
  /// not timed.
  DevicePtr clocks = 0;
  /// The loops of the program code that is loaded.
  ProgramLoops loops;
  /// The loops of program code that is planned, but not loaded yet.
  ProgramLoops planned;
  /// usesLoops: true if the code may contain loops. isOutdated: true if the
  /// loops of the loaded code no longer fit the parameters.
  bool usesLoops = true, isOutdated = false;
  std::vector<uint64_t> words;
};

} // namespace mlir::tai::runtime::programs

#endif // TAI_LIB_RUNTIME_PROGRAMS_KERNELWAY_H
