//===- GraphWay.cpp - Sequences as graphs ---------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "GraphWay.h"
#include "GraphOrder.h"
#include "tai/ABI/DeviceAbi.h"
#include <algorithm>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::programs;

ProgramPlan OverlappingKernels::plan(const Sequence &sequence) {
  std::vector<const Function *> parts = sequence.listParts();
  ProgramPlan plan;
  plan.scope = TAI_SCOPE_LAUNCHES;
  for (const Function *part : parts)
    plan.parts.push_back({part->bitcode, part->name, /*isInTable=*/false});
  // In a block of so many threads, each thread can have the maximum of
  // registers, so the compiler need not know the block size.
  constexpr unsigned unlimited = 256;
  for (const Step &step : sequence.steps)
    for (size_t i = 0; i < parts.size(); ++i)
      if (step.function == parts[i] && step.shape.threads > unlimited)
        plan.parts[i].threads =
            std::max(plan.parts[i].threads, step.shape.threads);
  return plan;
}

Status OverlappingKernels::adopt(Device &device, const Sequence &sequence,
                                 const DeviceImage &image) {
  std::vector<const Function *> parts = sequence.listParts();
  std::unique_ptr<DeviceModule> loaded;
  std::unordered_map<const Function *, DeviceFunction *> found;
  Status status = device.load(image, loaded);
  for (size_t i = 0; status && i < parts.size(); ++i)
    status = device.find(*loaded, image.functions[i], found[parts[i]]);
  if (!status)
    return status;
  module = std::move(loaded);
  functions = std::move(found);
  return status;
}

/// Captures the graph of the sequence, or changes the parameters of the present
/// graph.
Status GraphWay::update() {
  Status status = device.beginCapture(0, overlaps());
  if (!status)
    return status;
  StepRunner runner(device);
  status = runSteps(runner);
  Status ended = device.endCapture(graph);
  return status ? std::move(ended) : std::move(status);
}

Status GraphWay::launch() {
  Status status = makeCurrent();
  return status ? device.run(*graph) : std::move(status);
}

Status GraphWay::runSteps(StepRunner &runner) {
  Status status;
  size_t direct = 0, before = runner.numPieces(), at = 0;
  GraphOrder order(sequence);
  std::optional<GraphOrder::FrontFills> front;
  if (mode == ProgramMode::Aside)
    front = order.splitFront();
  if (front) {
    at = front->count;
    status = runner.finish();
    if (status)
      status = device.fillAside(front->aside);
    if (status && !front->first.empty()) {
      status = device.fillAll(front->first);
      ++direct;
    }
  }
  for (; status && at < order.size(); ++at) {
    const Step &step = order[at];
    if (front && at == front->join) {
      status = runner.finish();
      if (status)
        status = device.joinAside();
      if (!status)
        break;
    }
    if (step.kind != Step::Kind::Launch || !overlaps()) {
      status = runner.run(sequence, step);
    } else {
      status = runner.finish();
      LaunchShape shape = step.shape;
      shape.overlaps = true;
      ++direct;
      if (status)
        status = device.launch(overlapping->find(step.function), shape,
                               sequence.slots.data() + step.firstSlot,
                               static_cast<int>(step.numSlots));
    }
  }
  if (status)
    status = runner.finish();
  if (status && front && front->join == order.size())
    status = device.joinAside();
  numNodes = runner.numPieces() - before + direct;
  return status;
}

std::string GraphWay::describe() const {
  return numNodes > 0 ? " (" + std::to_string(numNodes) + " nodes)" : "";
}
