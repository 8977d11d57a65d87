//===- PrefixedGraphs.cpp - Sequences after other launches ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "PrefixedGraphs.h"
#include <algorithm>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::programs;

Status PrefixedGraphs::run(const Sequence &prefix, Way &way) {
  Prefixed &entry = find(prefix);
  // Like a sequence, a prefix (launches before a sequence) gets a graph only
  // when it is repeated.
  bool isFirst = entry.runs++ == 0, same = entry.prefix.slots == prefix.slots;
  entry.changes += !same;
  if (!isFirst && device.limits().hasGraphs && entry.refused.empty()) {
    bool isReady = entry.graph && entry.isCurrent;
    if (!isReady || (!same && !change(entry, prefix))) {
      entry.prefix = prefix;
      Status made = capture(entry, way);
      entry.isCurrent = made.ok();
      if (!made)
        entry.refused = made.message();
    }
    if (entry.isCurrent)
      return device.run(*entry.graph);
  }
  entry.prefix = prefix;
  Status status = prefix.run(device);
  return status ? way.launch() : std::move(status);
}

void PrefixedGraphs::noteChange() {
  for (const std::unique_ptr<Prefixed> &entry : entries)
    entry->isCurrent = false;
}

bool PrefixedGraphs::uses(const Module &module) const {
  return std::any_of(entries.begin(), entries.end(), [&](const auto &entry) {
    return entry->prefix.uses(module);
  });
}

PrefixedGraphs::Prefixed &PrefixedGraphs::find(const Sequence &prefix) {
  constexpr size_t most = 4;
  auto found =
      std::find_if(entries.begin(), entries.end(), [&](const auto &entry) {
        return entry->prefix.hasStructureOf(prefix);
      });
  if (found == entries.end()) {
    if (entries.size() == most)
      entries.erase(entries.begin());
    entries.push_back(std::make_unique<Prefixed>());
    entries.back()->prefix = prefix;
  } else {
    std::rotate(found, found + 1, entries.end());
  }
  return *entries.back();
}

/// Captures the launches of a prefix and the work of `way` as one graph.
Status PrefixedGraphs::capture(Prefixed &entry, Way &way) {
  Status status = way.prepareSteps();
  if (status)
    status =
        device.beginCapture(entry.prefix.countFirstLaunches(), way.overlaps());
  if (!status)
    return status;
  StepRunner runner(device);
  status = runner.runAll(entry.prefix);
  if (status)
    status = way.runSteps(runner);
  Status ended = device.endCapture(entry.graph);
  if (status && ended && !entry.graph)
    return Status::failure(StatusCode::Internal, "nothing was recorded");
  return status ? std::move(ended) : std::move(status);
}

/// Changes the parameters of the graph's launches to the parameters in
/// `prefix`. False if the graph must be captured again.
bool PrefixedGraphs::change(Prefixed &entry, const Sequence &prefix) {
  size_t changeable = prefix.countFirstLaunches();
  for (size_t i = 0; i < prefix.steps.size(); ++i) {
    const Step &step = prefix.steps[i];
    const uint64_t *now = prefix.slots.data() + step.firstSlot;
    const uint64_t *before = entry.prefix.slots.data() + step.firstSlot;
    if (std::equal(now, now + step.numSlots, before))
      continue;
    if (i >= changeable ||
        !device.change(*entry.graph, i, *step.function->function, step.shape,
                       now, static_cast<int>(step.numSlots)))
      return false;
  }
  entry.prefix = prefix;
  return true;
}

std::string PrefixedGraphs::explain() const {
  std::string text;
  for (const std::unique_ptr<Prefixed> &entry : entries) {
    text += "\n  with";
    for (const Step &step : entry->prefix.steps) {
      std::string name = step.function ? step.function->name : "a fill";
      text += (&step == entry->prefix.steps.data() ? " " : ", ") + name;
    }
    text += " before it: " + std::to_string(entry->runs) + " times, " +
            std::to_string(entry->changes) + " of them with new parameters";
    text += entry->graph             ? ", as one graph"
            : entry->refused.empty() ? ", launched one by one"
                                     : ", no graph: " + entry->refused;
  }
  return text;
}
