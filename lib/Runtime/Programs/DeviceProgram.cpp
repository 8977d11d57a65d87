//===- DeviceProgram.cpp - A repeated sequence of work --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Programs/DeviceProgram.h"
#include "GraphOrder.h"
#include "GraphWay.h"
#include "KernelWay.h"
#include "PrefixedGraphs.h"
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::programs;

//===----------------------------------------------------------------------===//
// The ways to run a sequence of launches
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

DeviceProgram::DeviceProgram(Device &device, Sequence steps)
    : sequence(std::move(steps)), device(device),
      schedules(std::make_unique<StepSchedules>(device, sequence)),
      overlapping(std::make_unique<OverlappingKernels>()),
      prefixed(std::make_unique<PrefixedGraphs>(device)) {}

DeviceProgram::~DeviceProgram() = default;

/// Predicts the milliseconds of a run from the cost of each launch or barrier,
/// and from the rounds that the threads make to cover each step. The constants
/// were measured on an H200; they only select the ways that are tried.
double DeviceProgram::predict(ProgramMode mode,
                              const LaunchShape &shape) const {
  constexpr double overlappedUs = 1.05, roundUs = 0.6, stageUs = 0.15,
                   graphUs = 1.3, blockUs = 0.15, clusterUs = 0.45,
                   gridUs = 1.1;
  double stepUs = mode == ProgramMode::Graph     ? graphUs
                  : isGraph(mode)                ? overlappedUs
                  : mode == ProgramMode::Block   ? blockUs
                  : mode == ProgramMode::Cluster ? clusterUs
                                                 : gridUs;
  // A graph waits after each of its nodes, while a kernel waits only at its
  // barriers.
  bool hasTiles = mode == ProgramMode::Tiles;
  const StepSchedules::Schedule &schedule = schedules->get(hasTiles);
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

void DeviceProgram::addWay(ProgramMode mode, const LaunchShape &shape) {
  double predicted = predict(mode, shape);
  if (isGraph(mode))
    ways.push_back(std::make_unique<GraphWay>(
        device, sequence, mode, predicted,
        mode == ProgramMode::Graph ? nullptr : overlapping.get()));
  else
    ways.push_back(std::make_unique<KernelWay>(
        device, sequence, mode, predicted, maker, *schedules, shape));
}

void DeviceProgram::listWays(ProgramMode wanted) {
  DeviceLimits limits = device.limits();
  unsigned width = sequence.width();
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
  // A program is linked from the bitcode of every device function in it.
  bool canMake = (maker || starter) && sequence.areAllPartsKnown();
  schedules->make(
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
    unsigned full = std::min(most, warps(width));
    add(ProgramMode::Block, 1, full);
    // With fewer threads in a block, each thread has more registers.
    for (unsigned threads : {full / 2, full / 4})
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
      // The program uses only as many blocks as have work, because each block
      // waits for all others at barriers.
      unsigned blocks = std::clamp((width + threads - 1) / threads, 2u,
                                   limits.multiprocessors);
      if (blocks == limits.multiprocessors)
        threads = std::min(512u, most);
      add(ProgramMode::Grid, blocks, threads);
    }
    if (schedules->hasTiles()) {
      LaunchShape tiles = schedules->tileShape();
      add(ProgramMode::Tiles, tiles.blocks,
          std::min(most, std::clamp(warps(tiles.threads), 128u, 512u)));
    }
  }
  std::sort(ways.begin(), ways.end(), [](const auto &a, const auto &b) {
    return a->predicted < b->predicted;
  });
  if (wanted == ProgramMode::Automatic)
    dropHopelessWays();
  // Ways with overlapping launches are worth compiling only if a graph is among
  // the fastest ways to run the sequence, so they are tried last.
  for (ProgramMode last : {ProgramMode::Overlapped, ProgramMode::Aside}) {
    auto found = std::find_if(ways.begin(), ways.end(), [&](const auto &way) {
      return way->mode == last;
    });
    if (found != ways.end())
      std::rotate(found, found + 1, ways.end());
  }
}

/// Drops kernels that the model predicts to be far slower than the best way.
/// Graphs stay: a plain graph needs no compilation, and is the fallback. If
/// code is compiled in the background, the plain graph is tried first, and only
/// kernels that are predicted to be faster stay.
void DeviceProgram::dropHopelessWays() {
  if (ways.empty())
    return;
  double limit = 3 * ways.front()->predicted;
  auto graph = std::find_if(ways.begin(), ways.end(), [](const auto &way) {
    return way->mode == ProgramMode::Graph;
  });
  if (starter && graph != ways.end()) {
    limit = std::min(limit, (*graph)->predicted);
    std::rotate(ways.begin(), graph, graph + 1);
  }
  ways.erase(std::remove_if(ways.begin(), ways.end(),
                            [&](const auto &way) {
                              return !way->isGraph() && way->predicted > limit;
                            }),
             ways.end());
}

//===----------------------------------------------------------------------===//
// Choosing
//===----------------------------------------------------------------------===//

/// True if a graph is among the fastest ways to run the sequence so far;
/// otherwise no graph with overlapping launches is tried.
bool DeviceProgram::mayOverlapPay() const {
  constexpr double gain = 0.75;
  const Way *graph = findGraph();
  return !graph || graph->measured < 0 || !used ||
         graph->measured * gain <= used->measured;
}

const Way *DeviceProgram::findGraph() const {
  for (const std::unique_ptr<Way> &way : ways)
    if (way->mode == ProgramMode::Graph)
      return way.get();
  return nullptr;
}

/// Returns the fastest of the ways to run the sequence whose trials have ended;
/// null if there is none.
Way *DeviceProgram::findFastest() const {
  Way *best = nullptr;
  for (const std::unique_ptr<Way> &way : ways)
    if (way->isTried && way->refused.empty() && way->measured >= 0 &&
        (!best || way->measured < best->measured))
      best = way.get();
  return best;
}

Status DeviceProgram::runTimed(Way &way) {
  Status status = device.synchronize();
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

void DeviceProgram::noteRun(bool same) {
  if (runs++ == 0 || same)
    return;
  ++changes;
  for (const std::unique_ptr<Way> &way : ways)
    way->noteChange();
  prefixed->noteChange();
}

/// Lists the ways in which the sequence can be run. Called for the second run
/// of the sequence.
void DeviceProgram::begin(ProgramMode mode, const Tools &tools) {
  begun = Clock::now();
  choices = tools.choices;
  // A mode that the user requested is compiled at once, not in the background.
  if (mode == ProgramMode::Automatic && tools.starter)
    starter = tools.starter;
  else
    maker = tools.maker;
  listWays(mode);
  if (mode != ProgramMode::Automatic || !choices.load)
    return;
  std::string key = choiceKey();
  std::optional<std::string> kept;
  if (!key.empty())
    kept = choices.load(key);
  if (!kept)
    return;
  for (const std::unique_ptr<Way> &way : ways)
    if (*kept == nameOf(way->mode))
      keptChoice = way->mode;
}

bool DeviceProgram::hasTrials() const {
  return std::any_of(ways.begin(), ways.end(),
                     [](const auto &way) { return !way->isTried; });
}

void DeviceProgram::refuse(Way &way, std::string why) {
  way.refused = std::move(why);
  endTrial(way);
}

void DeviceProgram::use(Way *way) {
  if (way == used)
    return;
  used = way;
  // Graphs that include launches before the sequence contain the way to run it
  // that was used before, so they are outdated now.
  prefixed->noteChange();
}

/// Ends the trial of a way to run the sequence: the fastest way so far is used,
/// and after the last trial stored as the choice.
void DeviceProgram::endTrial(Way &way) {
  way.isTried = true;
  way.job.reset();
  Way *best = findFastest();
  use(best);
  if (hasTrials() || !best)
    return;
  if (!best->hasTiles())
    schedules->dropTiles();
  if (choices.store && starter && ways.size() > 1)
    if (std::string key = choiceKey(); !key.empty())
      choices.store(std::move(key), nameOf(best->mode));
}

/// A compilation may begin once the sequence has run for a share of the time
/// that the compilation takes, which the bitcode of its kernels predicts: short
/// programs never start it.
bool DeviceProgram::isWorthCompiling(Way &way) const {
  constexpr double share = 0.5, fixed = 0.3, perByte = 20e-6;
  if (way.compileSeconds < 0) {
    size_t bytes = 0;
    for (const Function *part : sequence.listParts())
      bytes += part->bitcode->size();
    way.compileSeconds = fixed + perByte * double(bytes);
  }
  std::chrono::duration<double> elapsed = Clock::now() - begun;
  return elapsed.count() >= share * way.compileSeconds;
}

/// Trials of ways to run a sequence take at most a twentieth of the time since
/// its second run.
bool DeviceProgram::mayTry() const {
  constexpr int share = 20, numRuns = 3;
  double ms = used ? used->measured : 0;
  auto next = std::chrono::duration_cast<Clock::duration>(
      std::chrono::duration<double, std::milli>(numRuns * ms));
  return share * (spent + next) <= Clock::now() - begun;
}

bool DeviceProgram::makeCode(Way &way) {
  DeviceImage image;
  Status status;
  if (way.job) {
    if (!way.job->isDone() || !mayTry())
      return false;
    status = way.job->take(image);
    way.job.reset();
  } else {
    if (starter && !keptChoice && !isWorthCompiling(way))
      return false;
    ProgramPlan plan;
    status = way.plan(plan);
    if (status && starter) {
      way.job = starter(std::move(plan));
      if (way.job)
        return false;
      status =
          Status::failure(StatusCode::Internal, "no thread can compile it");
    } else if (status) {
      status = maker(plan, image);
    }
  }
  auto start = Clock::now();
  if (status)
    status = way.adopt(image);
  spent += Clock::now() - start;
  if (!status)
    refuse(way, status.message());
  return status.ok();
}

/// Returns the way that is tried in this run; null to run the sequence in the
/// best known way.
Way *DeviceProgram::nextTrial() {
  for (const std::unique_ptr<Way> &way : ways) {
    if (way->isTried)
      continue;
    if (starter && keptChoice && way->mode != *keptChoice &&
        way->mode != ProgramMode::Graph)
      refuse(*way, "an earlier process has found a faster way");
    else if (way->overlaps() && !mayOverlapPay())
      refuse(*way, "launches by themselves take too long");
    else if (way->needsCode() && !makeCode(*way)) {
      // The ways to run a sequence are compiled one after the other.
      if (!way->isTried)
        return nullptr;
    } else {
      // The first way to run the sequence, which is the fallback, is tried at
      // once and does not wait for a background compilation.
      bool waits =
          starter && way->tries == 0 && way.get() != ways.front().get();
      return waits && !mayTry() ? nullptr : way.get();
    }
  }
  return nullptr;
}

Status DeviceProgram::tryWay(Way &way) {
  // A trial consists of three runs; the first loads code and table, and is not
  // timed.
  constexpr int wanted = 3;
  auto start = Clock::now();
  Status status = way.makeCurrent();
  if (!status) {
    // If a way to run the sequence fails only because its code is outdated, new
    // code is compiled in the background.
    if (way.needsCode() && starter)
      way.tries = 0;
    else
      refuse(way, status.message());
    return runUsed();
  }
  hasStarted = true;
  status = way.tries == 0 ? way.launch() : runTimed(way);
  // The failure comes from one of the launches of the sequence, and would occur
  // in any way to run them.
  if (!status)
    return status;
  if (&way != ways.front().get())
    spent += Clock::now() - start;
  if (++way.tries == wanted)
    endTrial(way);
  return status;
}

/// Runs the sequence in the best known way.
Status DeviceProgram::runUsed() {
  if (!used) {
    hasStarted = true;
    return sequence.run(device);
  }
  Status status = used->makeCurrent();
  if (status) {
    hasStarted = true;
    return used->launch();
  }
  if (!used->needsCode())
    return status;
  // New code for this way to run the sequence is compiled in the background;
  // the sequence is run in another way meanwhile.
  Way &lost = *used;
  lost.isTried = false;
  lost.tries = 0;
  lost.measured = -1;
  use(findFastest());
  hasStarted = true;
  return used ? used->launch() : sequence.run(device);
}

Status DeviceProgram::run(bool same, ProgramMode mode, const Tools &tools) {
  return run(Sequence(), same, mode, tools);
}

Status DeviceProgram::run(const Sequence &prefix, bool same, ProgramMode mode,
                          const Tools &tools) {
  hasStarted = false;
  enum class Prefix { Waits, Runs, HasRun } prefixState = Prefix::Waits;
  try {
    noteRun(same);
    // A sequence that occurs only once is not prepared to be run as a graph or
    // program.
    if (runs == 2)
      begin(mode, tools);
    Way *trial = runs > 1 ? nextTrial() : nullptr;
    if (!prefix.empty() && used && !trial && used->makeCurrent()) {
      hasStarted = true;
      return prefixed->run(prefix, *used);
    }
    prefixState = Prefix::Runs;
    Status status = prefix.run(device);
    prefixState = Prefix::HasRun;
    if (!status)
      return status;
    return trial ? tryWay(*trial) : runUsed();
  } catch (const std::bad_alloc &) {
    // Out of memory: the steps that have not been queued are run one by one,
    // since the runtime relies on their effects.
    Status status;
    if (prefixState == Prefix::Waits && !hasStarted)
      status = prefix.run(device);
    if (status && !hasStarted)
      status = sequence.run(device);
    // If all steps have run, this is no failure: a later run can prepare the
    // program.
    if (hasStarted || prefixState == Prefix::Runs)
      throw;
    return status;
  }
}

/// A description of device, kernels and steps that is the same in other
/// processes, as a key for stored choices; empty if none can be given.
std::string DeviceProgram::choiceKey() const {
  std::string key = "program " + device.name() + "\n" + device.target() + "\n" +
                    std::to_string(device.limits().multiprocessors) + "\n";
  std::vector<const Function *> parts = sequence.listParts();
  for (const Function *part : parts) {
    if (part->imageKey.empty())
      return "";
    key += part->imageKey + " " + part->name + "\n";
  }
  uint64_t hash = 14695981039346656037ull;
  auto mix = [&](uint64_t value) { hash = (hash ^ value) * 1099511628211ull; };
  for (const Step &step : sequence.steps) {
    mix(static_cast<uint64_t>(step.kind));
    mix(static_cast<uint64_t>(
        std::find(parts.begin(), parts.end(), step.function) - parts.begin()));
    mix(uint64_t(step.shape.blocks) << 32 | step.shape.threads);
  }
  return key + std::to_string(sequence.steps.size()) + " " +
         std::to_string(hash);
}

std::string DeviceProgram::explain() const {
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
    if (&way == used)
      text += hasTrials() ? " (used)" : " (chosen)";
    else if (way.job)
      text += ", is being compiled";
    else if (!way.isTried && way.needsCode())
      text += ", not compiled yet";
    text += way.explainClocks();
  }
  return text + prefixed->explain();
}

bool DeviceProgram::uses(const Module &module) const {
  return sequence.uses(module) || prefixed->uses(module);
}

void DeviceProgram::tellTimes(double &chosenMs, double &graphMs) const {
  if (!used || hasTrials())
    return;
  chosenMs = used->measured;
  if (const Way *graph = findGraph())
    graphMs = graph->measured;
}
