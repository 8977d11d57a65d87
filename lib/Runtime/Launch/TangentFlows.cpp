//===- TangentFlows.cpp - Tangents that end where there is none -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "TangentFlows.h"
#include "Launch.h"
#include "tai/Runtime/Launch/Runtime.h"
#include <algorithm>

using namespace mlir::tai::runtime;

TangentFlows::TangentFlows(const std::vector<FieldPtr> &fields,
                           const std::vector<FieldPtr> &inputs)
    : tracker(FlowTracker::Mode::Forward, fields) {
  for (const FieldPtr &field : inputs)
    tracker.addSource(*field);
}

void TangentFlows::launch(Kernel &kernel, const uint64_t *args) {
  std::lock_guard<std::mutex> lock(mutex);
  hasLaunched = true;
  tracker.launch(kernel, args);
}

void TangentFlows::overwrite(const Field &field) {
  std::lock_guard<std::mutex> lock(mutex);
  // Before the first launch the host says at which point one differentiates.
  if (hasLaunched)
    tracker.overwrite(field);
}

std::vector<std::string>
TangentFlows::describe(const std::vector<FieldPtr> &outputs,
                       std::unordered_set<std::string> &said) {
  std::lock_guard<std::mutex> lock(mutex);
  FlowTracker::CutSet cuts;
  for (const FieldPtr &field : outputs) {
    const FlowTracker::CutSet &more = tracker.cutsOf(*field);
    cuts.insert(cuts.end(), more.begin(), more.end());
  }
  // In the order of the program.
  std::sort(cuts.begin(), cuts.end());
  cuts.erase(std::unique(cuts.begin(), cuts.end()), cuts.end());
  std::vector<std::string> lines;
  for (unsigned cut : cuts)
    if (said.insert("forward\n" + tracker.nameOf(cut)).second)
      lines.push_back(tracker.describe(cut));
  return lines;
}

void Runtime::followTangents(const std::vector<FieldPtr> &inputs) {
  tangentFlows = std::make_unique<TangentFlows>(fieldList, inputs);
}

std::vector<std::string>
Runtime::lostTangents(const std::vector<FieldPtr> &outputs) {
  return tangentFlows ? tangentFlows->describe(outputs, cutsSaid)
                      : std::vector<std::string>();
}

//===----------------------------------------------------------------------===//
// Launches in forward mode
//===----------------------------------------------------------------------===//

/// The tangents of what a kernel uses are of the thread that launches it, from
/// its first launch on: those that another one has left are zero to it.
void Runtime::takeOverTangents(const Kernel &kernel) {
  const char zeros[8] = {};
  for (const Access &access : kernel.summary()) {
    Field *tangent = access.field->dual();
    if (!tangent)
      continue;
    if (isOfAnotherThread(*tangent))
      fillWith(*tangent, zeros);
    tangent->markDirty();
  }
}

Status Runtime::runTangent(Launch &launch, Kernel &kernel, const uint64_t *args,
                           uint64_t *results, uint64_t number) {
  settleZeros();
  Kernel *tangent = nullptr;
  Status status = kernel.resolveTangent(tangent);
  if (status)
    status = kernel.bind(storageEpoch.load(std::memory_order_relaxed));
  if (!status)
    return status;
  for (Field *field : kernel.changedAdjoints)
    field->markDirty();
  if (tangentFlows)
    tangentFlows->launch(kernel, args);
  takeOverTangents(kernel);
  if (tangent == &kernel)
    return runCode(launch, kernel, args, results, number);
  if (!kernel.sparseNodes.empty() && !launch.given)
    kernel.noteBegin();
  status = runCode(launch, *tangent, args, results, number);
  if (!launch.loops.empty())
    kernel.noteLoops(launch.loops);
  return status;
}
