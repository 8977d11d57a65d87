//===- DeviceProgram.cpp - A repeated sequence of work --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "DeviceProgram.h"
#include "GraphOrder.h"
#include <algorithm>
#include <chrono>
#include <cstdio>

using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Ways to run a sequence
//===----------------------------------------------------------------------===//

static const char *nameOf(ProgramMode mode) {
  switch (mode) {
  case ProgramMode::Graph:
    return "a graph";
  case ProgramMode::Block:
    return "one kernel of one block";
  case ProgramMode::Cluster:
    return "one kernel of a cluster of blocks";
  case ProgramMode::Grid:
    return "one kernel of the whole grid";
  case ProgramMode::Overlapped:
    return "a graph of launches that overlap";
  case ProgramMode::Aside:
    return "a graph of launches that overlap, with fills beside them";
  case ProgramMode::Tiles:
    return "one kernel of the whole grid, with tiles";
  default:
    return "launches";
  }
}

static bool isGraph(ProgramMode mode) {
  return mode == ProgramMode::Graph || mode == ProgramMode::Overlapped ||
         mode == ProgramMode::Aside;
}

/// Milliseconds, by the cost of a launch or a barrier, and by how often the
/// threads go around. Constants as measured on an H200; they only decide which
/// ways are worth trying.
double DeviceQueue::Program::predict(ProgramMode mode,
                                     const LaunchShape &shape) const {
  constexpr double overlappedUs = 1.05, roundUs = 0.6, stageUs = 0.15,
                   graphUs = 1.3, blockUs = 0.15, clusterUs = 0.45,
                   gridUs = 1.1;
  double stepUs = mode == ProgramMode::Graph     ? graphUs
                  : isGraph(mode)                ? overlappedUs
                  : mode == ProgramMode::Block   ? blockUs
                  : mode == ProgramMode::Cluster ? clusterUs
                                                 : gridUs;
  // A graph has its own way to wait, after each node.
  bool hasTiles = mode == ProgramMode::Tiles;
  const StepSchedules::Schedule &schedule = schedules.get(hasTiles);
  size_t waits =
      isGraph(mode) ? sequence.steps.size() : schedule.order.numBarriers + 1;
  double us = stepUs * double(waits);
  for (const Step &step : sequence.steps) {
    double width = double(step.shape.blocks) * step.shape.threads;
    double rounds = 1;
    if (!isGraph(mode))
      rounds =
          std::max(1.0, width / (double(shape.blocks) * double(shape.threads)));
    us += roundUs * rounds;
  }
  if (hasTiles)
    for (const StepSchedules::Unit &unit : schedule.units)
      us -= (roundUs - stageUs) * double(unit.count - 1);
  return us * 1e-3;
}

void DeviceQueue::Program::addWay(ProgramMode mode, const LaunchShape &shape) {
  double predicted = predict(mode, shape);
  if (isGraph(mode))
    ways.push_back(std::make_unique<GraphWay>(
        device, sequence, mode, predicted, maker,
        mode == ProgramMode::Graph ? nullptr : &overlapping));
  else
    ways.push_back(std::make_unique<KernelWay>(
        device, sequence, mode, predicted, maker, schedules, shape));
}

void DeviceQueue::Program::listWays(ProgramMode wanted) {
  DeviceLimits limits = device.limits();
  unsigned width = sequence.getWidth();
  auto add = [&](ProgramMode mode, unsigned blocks, unsigned threads) {
    if (wanted != ProgramMode::Automatic && wanted != mode)
      return;
    LaunchShape shape;
    shape.blocks = blocks;
    shape.threads = threads;
    shape.cooperative = mode == ProgramMode::Grid || mode == ProgramMode::Tiles;
    shape.cluster = mode == ProgramMode::Cluster ? blocks : 0;
    addWay(mode, shape);
  };
  // Every part must be there to be put together again.
  bool canMake = maker && sequence.areAllPartsKnown();
  schedules.make(
      /*wantsTiles=*/canMake &&
      (limits.hasGridBarriers || device.kind() == DeviceKind::Emulated));
  auto warps = [](unsigned threads) { return (threads + 31) / 32 * 32; };
  if (limits.hasGraphs)
    add(ProgramMode::Graph, 0, 0);
  if (canMake) {
    if (limits.hasGraphs && limits.hasOverlaps)
      add(ProgramMode::Overlapped, 0, 0);
    if (limits.hasGraphs && limits.hasOverlaps &&
        GraphOrder(sequence).splitFront())
      add(ProgramMode::Aside, 0, 0);
    unsigned most = limits.threadsPerBlock;
    unsigned wide = std::min(most, warps(width));
    add(ProgramMode::Block, 1, wide);
    // Fewer threads have more registers each.
    for (unsigned threads : {wide / 2, wide / 4})
      if (threads >= 128)
        add(ProgramMode::Block, 1, warps(threads));
    if (limits.mostClusterBlocks > 1 && width > most / 2) {
      unsigned blocks = limits.mostClusterBlocks;
      unsigned threads =
          std::clamp(warps((width + blocks - 1) / blocks), 64u, 1024u);
      add(ProgramMode::Cluster, blocks, std::min(threads, most));
    }
    if (limits.hasGridBarriers && width > most) {
      unsigned threads = std::min(256u, most);
      // As few blocks as there is work for: each waits for all.
      unsigned blocks = std::clamp((width + threads - 1) / threads, 2u,
                                   limits.multiprocessors);
      if (blocks == limits.multiprocessors)
        threads = std::min(512u, most);
      add(ProgramMode::Grid, blocks, threads);
    }
    if (schedules.hasTiles()) {
      LaunchShape tiles = schedules.getTileShape();
      add(ProgramMode::Tiles, tiles.blocks,
          std::min(most, std::clamp(warps(tiles.threads), 128u, 512u)));
    }
  }
  std::sort(ways.begin(), ways.end(), [](const auto &a, const auto &b) {
    return a->predicted < b->predicted;
  });
  // A way that is far behind by the model is not tried. A graph always is: it
  // asks for no compilation and is the fallback.
  if (wanted == ProgramMode::Automatic && !ways.empty()) {
    double best = ways.front()->predicted;
    ways.erase(std::remove_if(ways.begin(), ways.end(),
                              [&](const auto &way) {
                                return !way->isGraph() &&
                                       way->predicted > 3 * best;
                              }),
               ways.end());
  }
  // Worth its compilation only where a graph is among the best.
  for (ProgramMode last : {ProgramMode::Overlapped, ProgramMode::Aside}) {
    auto found = std::find_if(ways.begin(), ways.end(), [&](const auto &way) {
      return way->mode == last;
    });
    if (found != ways.end())
      std::rotate(found, found + 1, ways.end());
  }
}

//===----------------------------------------------------------------------===//
// Choosing
//===----------------------------------------------------------------------===//

/// Whether a graph is among the best of the tried ways: else its launches need
/// not be made to overlap.
bool DeviceQueue::Program::mayOverlapPay() const {
  constexpr double gain = 0.75;
  double graph = 0, best = 0;
  for (const std::unique_ptr<Way> &way : ways) {
    if (way->measured < 0)
      continue;
    if (way->mode == ProgramMode::Graph)
      graph = way->measured;
    best = best > 0 ? std::min(best, way->measured) : way->measured;
  }
  return graph * gain <= best;
}

Status DeviceQueue::Program::prepare(Way &way) {
  way.isReady = true;
  if (way.overlaps() && !mayOverlapPay())
    return Status::failure(StatusCode::Internal,
                           "launches by themselves take too long");
  return way.prepare();
}

Status DeviceQueue::Program::runTimed(Way &way) {
  using Clock = std::chrono::steady_clock;
  Status status = way.makeCurrent();
  if (status)
    status = device.synchronize();
  auto start = Clock::now();
  if (status)
    status = way.launch();
  if (status)
    status = device.synchronize();
  double ms =
      std::chrono::duration<double, std::milli>(Clock::now() - start).count();
  if (status)
    way.measured = way.measured < 0 ? ms : std::min(way.measured, ms);
  return status;
}

void DeviceQueue::Program::noteRun(bool same) {
  if (runs++ == 0 || same)
    return;
  ++changes;
  for (const std::unique_ptr<Way> &way : ways)
    way->noteChange();
  prefixed.noteChange();
}

Status DeviceQueue::Program::run(const Sequence &prefix, bool same,
                                 ProgramMode mode,
                                 const ProgramMaker &programMaker) {
  bool isChosen = chosen && current < ways.size();
  if (prefix.empty() || !isChosen) {
    Status status = StepRunner::runAlone(device, prefix);
    return status ? run(same, mode, programMaker) : std::move(status);
  }
  noteRun(same);
  return prefixed.run(prefix, *ways[current]);
}

Status DeviceQueue::Program::run(bool same, ProgramMode mode,
                                 const ProgramMaker &programMaker) {
  noteRun(same);
  auto runSteps = [&] { return StepRunner::runAlone(device, sequence); };
  // A sequence that comes once need not be made ready for a second time.
  if (runs == 1)
    return runSteps();
  if (runs == 2) {
    maker = programMaker;
    listWays(mode);
  }
  if (chosen || ways.empty())
    return current < ways.size() ? ways[current]->launch() : runSteps();

  while (current < ways.size()) {
    Way &way = *ways[current];
    Status status;
    if (!way.isReady)
      status = prepare(way);
    // The first of three runs brings code and table to where they are used.
    constexpr int wanted = 3;
    if (status) {
      status = tries == 0 ? way.launch() : runTimed(way);
      // A failure on the device is one of the program, whatever the way.
      if (!status)
        return status;
      if (++tries == wanted) {
        tries = 0;
        ++current;
      }
      if (current < ways.size())
        return status;
    } else {
      way.refused = status.message();
      ++current;
      tries = 0;
      if (current < ways.size())
        continue;
    }
    // All have been tried.
    size_t best = ways.size();
    for (size_t i = 0; i < ways.size(); ++i)
      if (ways[i]->refused.empty() &&
          (best == ways.size() || ways[i]->measured < ways[best]->measured))
        best = i;
    chosen = true;
    bool hasRun = bool(status);
    current = best;
    if (best == ways.size())
      return hasRun ? std::move(status) : runSteps();
    if (!ways[best]->hasTiles())
      schedules.dropTiles();
    return hasRun ? std::move(status) : ways[best]->launch();
  }
  return runSteps();
}

std::string DeviceQueue::Program::explain() const {
  std::string text = std::to_string(sequence.steps.size()) + " steps, run " +
                     std::to_string(runs) + " times, " +
                     std::to_string(changes) + " of them with new parameters";
  for (size_t i = 0; i < ways.size(); ++i) {
    const Way &way = *ways[i];
    text += std::string("; ") + nameOf(way.mode) + way.describe();
    if (!way.refused.empty()) {
      text += ": refused: " + way.refused;
      continue;
    }
    char line[256];
    std::snprintf(line, sizeof(line), ": %.4f ms by the model", way.predicted);
    text += line;
    if (way.measured >= 0) {
      std::snprintf(line, sizeof(line), ", %.4f ms measured", way.measured);
      text += line;
    }
    if (chosen && i == current)
      text += " (chosen)";
    text += way.explainClocks();
  }
  return text + prefixed.explain();
}

bool DeviceQueue::Program::uses(const Module &module) const {
  return sequence.uses(module) || prefixed.uses(module);
}

void DeviceQueue::Program::tellTimes(double &chosenMs, double &graphMs) const {
  if (!chosen || current >= ways.size())
    return;
  chosenMs = ways[current]->measured;
  for (const std::unique_ptr<Way> &way : ways)
    if (way->mode == ProgramMode::Graph)
      graphMs = way->measured;
}
