//===- DeviceProgramPrefix.cpp - Launches in front of sequences -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What was launched between two replays runs with the second one, as one graph
// where the device has graphs. The program of the replay stays as it is, so one
// that comes without them needs nothing new. See
// docs/decisions/0014-launches-between-replays.md.
//
//===----------------------------------------------------------------------===//

#include "FillRun.h"
#include <algorithm>

using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Sequences behind others
//===----------------------------------------------------------------------===//

Status DeviceQueue::Program::run(const Sequence &lead, bool same,
                                 ProgramMode mode,
                                 const ProgramMaker &programMaker) {
  bool isChosen = chosen && current < ways.size();
  if (lead.empty() || !isChosen) {
    Status status = lead.run(device);
    return status ? run(same, mode, programMaker) : std::move(status);
  }
  noteRun(same);
  return runLed(findLed(lead), lead, ways[current]);
}

DeviceQueue::Program::Led &DeviceQueue::Program::findLed(const Sequence &lead) {
  constexpr size_t most = 4;
  auto found = std::find_if(leds.begin(), leds.end(), [&](const auto &led) {
    return led->lead.hasStructureOf(lead);
  });
  if (found == leds.end()) {
    if (leds.size() == most)
      leds.erase(leds.begin());
    leds.push_back(std::make_unique<Led>());
    leds.back()->lead = lead;
  } else {
    std::rotate(found, found + 1, leds.end());
  }
  return *leds.back();
}

Status DeviceQueue::Program::runLed(Led &led, const Sequence &lead, Way &way) {
  // As with sequences, what comes once is not made ready for a second time.
  bool isFirst = led.runs++ == 0, same = led.lead.slots == lead.slots;
  led.changes += !same;
  if (!isFirst && device.limits().hasGraphs && led.refused.empty()) {
    bool isReady = led.graph && led.isCurrent;
    if (!isReady || (!same && !changeLed(led, lead))) {
      led.lead = lead;
      Status made = captureLed(led, way);
      led.isCurrent = made.ok();
      if (!made)
        led.refused = made.message();
    }
    if (led.isCurrent)
      return device.run(*led.graph);
  }
  led.lead = lead;
  Status status = lead.run(device);
  return status ? launch(way) : std::move(status);
}

/// So many launches come before anything else.
static constexpr auto numFirstLaunches = [](const auto &sequence) {
  auto isOther = [](const auto &step) { return !step.function; };
  return static_cast<size_t>(
      std::find_if(sequence.steps.begin(), sequence.steps.end(), isOther) -
      sequence.steps.begin());
};

/// Records it with what stands for the sequence on the device now.
Status DeviceQueue::Program::captureLed(Led &led, Way &way) {
  Status status;
  if (!way.isGraph())
    status = makeCurrent(way);
  if (status)
    status = device.beginCapture(numFirstLaunches(led.lead), way.overlaps());
  if (!status)
    return status;
  StepRunner runner(device);
  status = runner.runAll(led.lead);
  if (status)
    status =
        way.isGraph() ? runGraphSteps(way, runner) : runKernel(way, runner);
  Status ended = device.endCapture(led.graph);
  if (status && ended && !led.graph)
    return Status::failure(StatusCode::Internal, "nothing was recorded");
  return status ? std::move(ended) : std::move(status);
}

/// Changes the launches whose parameters are others now. False where the graph
/// must be made again.
bool DeviceQueue::Program::changeLed(Led &led, const Sequence &lead) {
  size_t changeable = numFirstLaunches(lead);
  for (size_t i = 0; i < lead.steps.size(); ++i) {
    const Step &step = lead.steps[i];
    const uint64_t *now = lead.slots.data() + step.firstSlot;
    const uint64_t *before = led.lead.slots.data() + step.firstSlot;
    if (std::equal(now, now + step.numSlots, before))
      continue;
    if (i >= changeable ||
        !device.change(*led.graph, i, *step.function->function, step.shape, now,
                       static_cast<int>(step.numSlots)))
      return false;
  }
  led.lead = lead;
  return true;
}

std::string DeviceQueue::Program::explainLeads() const {
  std::string text;
  for (const std::unique_ptr<Led> &led : leds) {
    text += "\n  with";
    for (const Step &step : led->lead.steps) {
      std::string name = step.function ? step.function->name : "a fill";
      text += (&step == led->lead.steps.data() ? " " : ", ") + name;
    }
    text += " before it: " + std::to_string(led->runs) + " times, " +
            std::to_string(led->changes) + " of them with new parameters";
    text += led->graph             ? ", as one graph"
            : led->refused.empty() ? ", launched one by one"
                                   : ", no graph: " + led->refused;
  }
  return text;
}
