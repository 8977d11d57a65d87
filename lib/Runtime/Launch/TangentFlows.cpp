//===- TangentFlows.cpp - Lost tangents in forward mode -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "TangentFlows.h"
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
  // Writes of the host before the first launch set the point at which to
  // differentiate, and end no tangent.
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
  // Lost tangents are reported in the order of the launches that lost them.
  std::sort(cuts.begin(), cuts.end());
  cuts.erase(std::unique(cuts.begin(), cuts.end()), cuts.end());
  std::vector<std::string> lines;
  for (unsigned cut : cuts)
    if (said.insert("forward\n" + tracker.nameOf(cut)).second)
      lines.push_back(tracker.describe(cut));
  return lines;
}
