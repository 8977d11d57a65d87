//===- GraphWay.h - Sequences as graphs -------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_PROGRAMS_GRAPHWAY_H
#define TAI_LIB_RUNTIME_PROGRAMS_GRAPHWAY_H

#include "ProgramWay.h"

namespace mlir::tai::runtime::programs {

/// Kernels for programmatic dependent launch, one for each device function of a
/// sequence. Shared by the modes Overlapped and Aside.
class OverlappingKernels {
public:
  bool areMade() const { return !functions.empty(); }
  /// plan: describes the kernels to compile. adopt: creates the kernels from
  /// the compiled code.
  static ProgramPlan plan(const Sequence &sequence);
  Status adopt(Device &device, const Sequence &sequence,
               const DeviceImage &image);
  DeviceFunction &find(const Function *function) const {
    return *functions.at(function);
  }

private:
  std::unique_ptr<DeviceModule> module;
  std::unordered_map<const Function *, DeviceFunction *> functions;
};

class GraphWay final : public Way {
public:
  /// `overlapping`: the kernels for programmatic dependent launch; null for a
  /// graph whose launches do not overlap.
  GraphWay(Device &device, const Sequence &sequence, ProgramMode mode,
           double predicted, OverlappingKernels *overlapping)
      : Way(device, mode, predicted), sequence(sequence),
        overlapping(overlapping) {}

  bool isGraph() const override { return true; }
  bool overlaps() const override { return overlapping != nullptr; }
  bool needsCode() const override {
    return overlapping && !overlapping->areMade();
  }
  Status plan(ProgramPlan &plan) override {
    plan = OverlappingKernels::plan(sequence);
    return Status::success();
  }
  Status adopt(const DeviceImage &image) override {
    return overlapping->adopt(device, sequence, image);
  }
  Status launch() override;
  Status prepareSteps() override { return Status::success(); }
  Status runSteps(StepRunner &runner) override;
  std::string describe() const override;

private:
  Status update() override;

  const Sequence &sequence;
  OverlappingKernels *overlapping;
  std::unique_ptr<DeviceGraph> graph;
  /// The number of graph nodes that run one after another.
  size_t numNodes = 0;
};

} // namespace mlir::tai::runtime::programs

#endif // TAI_LIB_RUNTIME_PROGRAMS_GRAPHWAY_H
