//===- DeviceProgramGraph.cpp - Sequences of launches as graphs -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "FillRun.h"
#include "tai/ABI/DeviceAbi.h"
#include <algorithm>

using namespace mlir::tai::runtime;

/// Whether a graph is among the best of what has been tried: else its launches
/// need not be made to overlap.
bool DeviceQueue::Program::mayOverlapPay() const {
  constexpr double gain = 0.75;
  double graph = 0, best = 0;
  for (const Way &way : ways) {
    if (way.measured < 0)
      continue;
    if (way.mode == ProgramMode::Graph)
      graph = way.measured;
    best = best > 0 ? std::min(best, way.measured) : way.measured;
  }
  return graph * gain <= best;
}

/// Makes kernels that wait by themselves for what comes before them.
Status DeviceQueue::Program::prepareOverlapped(Way &way) {
  if (!mayOverlapPay())
    return Status::failure(StatusCode::Internal,
                           "launches by themselves take too long");
  // With fills beside launches, the kernels are the same.
  for (const Way &other : ways)
    if (&other != &way && !other.overlapping.empty()) {
      way.overlapping = other.overlapping;
      return makeCurrent(way);
    }
  std::vector<const Function *> parts = listParts();
  ProgramPlan plan;
  plan.scope = TAI_SCOPE_LAUNCHES;
  for (const Function *part : parts)
    plan.parts.push_back(
        {part->bitcode.get(), part->name, /*isInTable=*/false});
  // Each thread of so many has as many registers as it likes.
  constexpr unsigned unlimited = 256;
  for (const Step &step : sequence.steps)
    for (size_t i = 0; i < parts.size(); ++i)
      if (step.function == parts[i] && step.shape.threads > unlimited)
        plan.parts[i].threads =
            std::max(plan.parts[i].threads, step.shape.threads);
  DeviceImage image;
  Status status = maker(plan, image);
  if (status)
    status = device.load(image, way.module);
  for (size_t i = 0; status && i < parts.size(); ++i)
    status =
        device.find(*way.module, image.functions[i], way.overlapping[parts[i]]);
  return status ? makeCurrent(way) : std::move(status);
}

/// Makes or changes the graph.
Status DeviceQueue::Program::capture(Way &way) {
  Status status = device.beginCapture(0, way.overlaps());
  if (!status)
    return status;
  StepRunner runner(device);
  status = runGraphSteps(way, runner);
  Status ended = device.endCapture(way.graph);
  return status ? std::move(ended) : std::move(status);
}

Status DeviceQueue::Program::runGraphSteps(Way &way, StepRunner &runner) {
  Status status;
  size_t direct = 0, before = runner.numPieces(), at = 0;
  std::vector<uint32_t> order = orderForGraph();
  FrontFills front;
  bool isAside = way.mode == ProgramMode::Aside && splitFront(order, front);
  if (isAside) {
    at = front.count;
    status = runner.finish();
    if (status)
      status = device.fillAside(front.aside);
    if (status && !front.first.empty()) {
      status = device.fillAll(front.first);
      ++direct;
    }
  }
  for (; status && at < order.size(); ++at) {
    const Step &step = sequence.steps[order[at]];
    if (isAside && at == front.join) {
      status = runner.finish();
      if (status)
        status = device.joinAside();
      if (!status)
        break;
    }
    if (step.kind != Step::Kind::Launch || way.overlapping.empty()) {
      status = runner.run(sequence, step);
    } else {
      status = runner.finish();
      LaunchShape shape = step.shape;
      shape.overlaps = true;
      ++direct;
      if (status)
        status = device.launch(*way.overlapping.at(step.function), shape,
                               sequence.slots.data() + step.firstSlot,
                               static_cast<int>(step.numSlots));
    }
  }
  if (status)
    status = runner.finish();
  if (status && isAside && front.join == order.size())
    status = device.joinAside();
  way.numNodes = runner.numPieces() - before + direct;
  return status;
}
