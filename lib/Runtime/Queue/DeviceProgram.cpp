//===- DeviceProgram.cpp - A sequence of work that comes again ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A program is a table of steps, and a kernel that goes through it: all its
// threads run a step together, and meet at a barrier before the next one. A
// barrier costs a fraction of a launch, and the fewer threads take part the
// less. The table is made again when parameters change, the kernel never.
//
//===----------------------------------------------------------------------===//

#include "FillRun.h"
#include "tai/ABI/DeviceAbi.h"
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <numeric>
#include <unordered_map>
#include <unordered_set>

using namespace mlir::tai::runtime;

void DeviceQueue::Sequence::append(const Sequence &other) {
  for (const Step &step : other.steps) {
    Step added = step;
    added.firstSlot = slots.size();
    auto first = other.slots.begin() + static_cast<ptrdiff_t>(step.firstSlot);
    slots.insert(slots.end(), first,
                 first + static_cast<ptrdiff_t>(step.numSlots));
    add(added);
  }
}

bool DeviceQueue::Sequence::hasStructureOf(const Sequence &other) const {
  return hash == other.hash && steps.size() == other.steps.size() &&
         std::equal(steps.begin(), steps.end(), other.steps.begin(),
                    [](const Step &a, const Step &b) {
                      return a.kind == b.kind && a.function == b.function &&
                             a.numSlots == b.numSlots &&
                             a.shape.blocks == b.shape.blocks &&
                             a.shape.threads == b.shape.threads;
                    });
}

DeviceRows DeviceQueue::Sequence::rowsOf(const Step &step) const {
  const uint64_t *values = slots.data() + step.firstSlot;
  auto number = [&](int at) { return static_cast<int64_t>(values[at]); };
  if (step.kind == Step::Kind::Fill)
    return {values[0], 0, number(2) * number(3), 1};
  return {values[0], number(1), number(2), number(3), number(6), number(7)};
}

Status DeviceQueue::Sequence::run(Device &device, const Step &step) const {
  const uint64_t *values = slots.data() + step.firstSlot;
  auto number = [&](int at) { return static_cast<int64_t>(values[at]); };
  switch (step.kind) {
  case Step::Kind::Launch:
    return device.launch(*step.function->function, step.shape, values,
                         static_cast<int>(step.numSlots));
  case Step::Kind::Fill:
    return device.fill(values[0], values + 1, static_cast<int>(values[2]),
                       static_cast<int64_t>(values[3]));
  case Step::Kind::Copy:
    return device.copy(values[0], values[1], static_cast<int64_t>(values[2]));
  case Step::Kind::FillRows:
    return device.fillRows(rowsOf(step), values + 4,
                           static_cast<int>(values[5]));
  case Step::Kind::CopyRows:
    return device.copyRows(rowsOf(step), values[4], number(5));
  case Step::Kind::SwapRows:
    return device.swapRows(rowsOf(step), values[4], number(5));
  }
  return Status::success();
}

Status DeviceQueue::Sequence::run(Device &device) const {
  StepRunner runner(device);
  Status status = runner.runAll(*this);
  return status ? runner.finish() : std::move(status);
}

//===----------------------------------------------------------------------===//
// Ways to run a sequence
//===----------------------------------------------------------------------===//

DeviceQueue::Program::~Program() {
  for (Way &way : ways) {
    if (way.table)
      device.free(way.table);
    if (way.clocks)
      device.free(way.clocks);
  }
}

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

static int scopeOf(ProgramMode mode, DeviceKind kind) {
  // All blocks of the emulated device meet as threads of a block do.
  if (mode == ProgramMode::Block || kind == DeviceKind::Emulated)
    return TAI_SCOPE_BLOCK;
  return mode == ProgramMode::Cluster ? TAI_SCOPE_CLUSTER : TAI_SCOPE_GRID;
}

/// The most threads that a step has work for.
unsigned DeviceQueue::Program::getWidth() const {
  uint64_t width = 1;
  for (const Step &step : sequence.steps)
    width = std::max(width, uint64_t(step.shape.blocks) * step.shape.threads);
  return static_cast<unsigned>(std::min<uint64_t>(width, 1u << 30));
}

/// Milliseconds, by what one launch or barrier costs, and by how often the
/// threads go around. Constants as measured on an H200; what they decide is
/// only what is worth trying.
double DeviceQueue::Program::predict(const Way &way) const {
  constexpr double overlappedUs = 1.05, roundUs = 0.6, stageUs = 0.15,
                   graphUs = 1.3, blockUs = 0.15, clusterUs = 0.45,
                   gridUs = 1.1;
  double stepUs = way.mode == ProgramMode::Graph     ? graphUs
                  : way.overlaps()                   ? overlappedUs
                  : way.mode == ProgramMode::Block   ? blockUs
                  : way.mode == ProgramMode::Cluster ? clusterUs
                                                     : gridUs;
  // A graph has its own way to wait, after each node.
  const Schedule &schedule = scheduleOf(way);
  size_t waits =
      way.isGraph() ? sequence.steps.size() : schedule.order.numBarriers + 1;
  double us = stepUs * double(waits);
  for (const Step &step : sequence.steps) {
    double width = double(step.shape.blocks) * step.shape.threads;
    double rounds = 1;
    if (!way.isGraph())
      rounds = std::max(
          1.0, width / (double(way.shape.blocks) * double(way.shape.threads)));
    us += roundUs * rounds;
  }
  if (way.hasTiles)
    for (const Unit &unit : schedule.units)
      us -= (roundUs - stageUs) * double(unit.count - 1);
  return us * 1e-3;
}

void DeviceQueue::Program::listWays(ProgramMode wanted) {
  DeviceLimits limits = device.limits();
  unsigned width = getWidth();
  auto add = [&](ProgramMode mode, unsigned blocks, unsigned threads) {
    if (wanted != ProgramMode::Automatic && wanted != mode)
      return;
    Way way;
    way.mode = mode;
    way.shape.blocks = blocks;
    way.shape.threads = threads;
    way.hasTiles = mode == ProgramMode::Tiles;
    way.shape.cooperative = mode == ProgramMode::Grid || way.hasTiles;
    way.shape.cluster = mode == ProgramMode::Cluster ? blocks : 0;
    way.predicted = predict(way);
    ways.push_back(std::move(way));
  };
  numBefore = countStepsBefore();
  schedule();
  auto warps = [](unsigned threads) { return (threads + 31) / 32 * 32; };
  if (limits.hasGraphs)
    add(ProgramMode::Graph, 0, 0);
  // Every part must be there to be put together again.
  if (maker && areAllPartsKnown()) {
    if (limits.hasGraphs && limits.hasOverlaps)
      add(ProgramMode::Overlapped, 0, 0);
    FrontFills front;
    if (limits.hasGraphs && limits.hasOverlaps &&
        splitFront(orderForGraph(), front))
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
    if (!tiled.units.empty()) {
      // A block for each tile, and a thread for each of its cells.
      int64_t blocks = 1, cells = 1;
      for (const Unit &unit : tiled.units)
        if (unit.chain >= 0) {
          const TileChain &chain = chains[static_cast<size_t>(unit.chain)];
          blocks = std::max(blocks, chain.numTiles());
          cells = std::max(cells, chain.mostCells());
        }
      add(ProgramMode::Tiles, static_cast<unsigned>(blocks),
          std::min(most, std::clamp(warps(static_cast<unsigned>(cells)), 128u,
                                    512u)));
    }
  }
  std::sort(ways.begin(), ways.end(), [](const Way &a, const Way &b) {
    return a.predicted < b.predicted;
  });
  // What is far behind by the model is not tried. A graph is, always: it asks
  // for no compilation and is what to fall back to.
  if (wanted == ProgramMode::Automatic && !ways.empty()) {
    double best = ways.front().predicted;
    ways.erase(std::remove_if(ways.begin(), ways.end(),
                              [&](const Way &way) {
                                return !way.isGraph() &&
                                       way.predicted > 3 * best;
                              }),
               ways.end());
  }
  // Worth its compilation only where a graph is among the best.
  for (ProgramMode last : {ProgramMode::Overlapped, ProgramMode::Aside}) {
    auto found = std::find_if(ways.begin(), ways.end(),
                              [&](const Way &way) { return way.mode == last; });
    if (found != ways.end())
      std::rotate(found, found + 1, ways.end());
  }
}

//===----------------------------------------------------------------------===//
// Getting ready
//===----------------------------------------------------------------------===//

/// Whether the steps of programs are timed, for tape.explain(). Reading the
/// clock costs some nanoseconds a step, so it must be asked for.
static bool areStepsTimed() {
  const char *given = std::getenv("TAI_PROGRAM_CLOCKS");
  return given && *given && *given != '0';
}

/// The functions of the parts, in the order of their numbers. That is the order
/// of the sequence: the order of the schedule is another one with other
/// parameters, for which the kernel is not made again.
std::vector<const DeviceQueue::Function *>
DeviceQueue::Program::listParts() const {
  std::vector<const Function *> parts;
  std::unordered_set<const Function *> seen;
  for (const Step &step : sequence.steps)
    if (step.function && seen.insert(step.function).second)
      parts.push_back(step.function);
  return parts;
}

/// The steps with the numbers of their parts, in the order of the schedule.
std::vector<LoopStep> DeviceQueue::Program::listSteps(const Way &way) const {
  const Schedule &schedule = scheduleOf(way);
  std::unordered_map<const Function *, uint64_t> numbers;
  for (const Function *part : listParts())
    numbers.emplace(part, TAI_FIRST_PART + numbers.size());
  std::vector<LoopStep> steps;
  steps.reserve(schedule.units.size());
  for (size_t i = 0; i < schedule.units.size(); ++i) {
    const Unit &unit = schedule.unit(i);
    const Step &step = sequence.steps[unit.first];
    LoopStep listed;
    listed.part = step.function ? numbers.at(step.function) : partOf(step.kind);
    listed.waits = schedule.order.waits[i];
    listed.slots = sequence.slots.data() + step.firstSlot;
    listed.numSlots = step.numSlots;
    if (unit.chain >= 0) {
      // The slots of its launches stand one behind the other.
      const Step &last = sequence.steps[unit.first + unit.count - 1];
      listed.part = firstChainPart + static_cast<uint64_t>(unit.chain);
      listed.numSlots = last.firstSlot + last.numSlots - step.firstSlot;
    }
    steps.push_back(listed);
  }
  return steps;
}

Status DeviceQueue::Program::prepare(Way &way) {
  way.isReady = true;
  if (way.overlaps())
    return prepareOverlapped(way);
  if (way.mode == ProgramMode::Graph)
    return makeCurrent(way);
  return makeKernel(way, ProgramLoops(listSteps(way), /*useLoops=*/true));
}

/// Makes the kernel for these loops. The way stays as it is where that fails.
Status DeviceQueue::Program::makeKernel(Way &way, ProgramLoops loops) {
  ProgramPlan plan;
  if (!loops.isComplete())
    return Status::failure(StatusCode::Internal, "there are too many chains");
  plan.segments = loops.getSegments();
  plan.words = loops.numWords();
  plan.scope = scopeOf(way.mode, device.kind());
  plan.threads = way.shape.threads;
  plan.isTimed = areStepsTimed();
  std::vector<LoopStep> steps = listSteps(way);
  for (const Function *part : listParts())
    plan.parts.push_back(
        {part->bitcode.get(), part->name, /*isInTable=*/false});
  if (way.hasTiles)
    addTiles(plan);
  for (const ProgramSegment &segment : plan.segments)
    for (size_t i = 0; !segment.isLoop() && i < segment.count; ++i) {
      uint64_t part = steps[segment.first + i].part;
      if (part >= TAI_FIRST_PART)
        plan.parts[part - TAI_FIRST_PART].isInTable = true;
    }
  DeviceImage image;
  std::unique_ptr<DeviceModule> module;
  DeviceFunction *function = nullptr;
  Status status = maker(plan, image);
  if (status)
    status = device.load(image, module);
  if (status)
    status = device.find(*module, image.functions.front(), function);
  // What has been queued may still run the one before.
  if (status && way.module)
    status = device.synchronize();
  if (!status)
    return status;
  way.module = std::move(module);
  way.function = function;
  way.loops = std::move(loops);
  unsigned most = device.mostThreads(*way.function);
  if (way.hasTiles && way.shape.threads > most)
    return Status::failure(StatusCode::Internal,
                           "there is no room for a thread for each cell");
  if (way.shape.threads > most)
    way.shape.threads = std::max(most / 32 * 32, 1u);
  if (way.shape.cooperative) {
    unsigned resident = device.residentBlocks(*way.function, way.shape.threads);
    if (way.hasTiles && resident < way.shape.blocks)
      return Status::failure(StatusCode::Internal,
                             "there is no room for all tiles at a time");
    way.shape.blocks = std::min(way.shape.blocks, resident);
  }
  return status;
}

uint64_t DeviceQueue::Program::partOf(Step::Kind kind) {
  switch (kind) {
  case Step::Kind::Fill:
    return TAI_PART_FILL;
  case Step::Kind::Copy:
    return TAI_PART_COPY;
  case Step::Kind::FillRows:
    return TAI_PART_FILL_ROWS;
  case Step::Kind::CopyRows:
    return TAI_PART_COPY_ROWS;
  default:
    return TAI_PART_SWAP_ROWS;
  }
}

StepMemory DeviceQueue::Program::memoryOf(const Step &step) const {
  const uint64_t *values = sequence.slots.data() + step.firstSlot;
  StepMemory memory;
  auto addRows = [&](DeviceAccess::Kind kind, uint64_t address,
                     uint64_t pitch) {
    memory.addRows(kind, address, pitch, values[2], values[3]);
  };
  switch (step.kind) {
  case Step::Kind::Launch:
    return StepMemory::ofLaunch(step.function->footprint.get(), values,
                                step.numSlots);
  case Step::Kind::Fill:
    // Single bytes are filled eight at a time.
    if (values[2] > 1)
      memory.addNumbers(DeviceAccess::Write, values[0],
                        static_cast<int64_t>(values[2]),
                        static_cast<int64_t>(values[3]));
    else
      memory.add(DeviceAccess::Write, values[0], values[3]);
    break;
  case Step::Kind::Copy:
    memory.add(DeviceAccess::Write, values[0], values[2]);
    memory.add(DeviceAccess::Read, values[1], values[2]);
    break;
  case Step::Kind::FillRows:
    for (uint64_t group = 0; group < values[7]; ++group)
      addRows(DeviceAccess::Write, values[0] + group * values[6], values[1]);
    break;
  case Step::Kind::CopyRows:
    addRows(DeviceAccess::Write, values[0], values[1]);
    addRows(DeviceAccess::Read, values[4], values[5]);
    break;
  case Step::Kind::SwapRows:
    addRows(DeviceAccess::Write, values[0], values[1]);
    addRows(DeviceAccess::Write, values[4], values[5]);
    break;
  }
  return memory;
}

/// A program has few threads, often. What moves much memory before it starts,
/// such as clearing the gradients of all time steps, is left to the device.
size_t DeviceQueue::Program::countStepsBefore() const {
  constexpr uint64_t muchBytes = 1 << 20;
  uint64_t bytes = 0;
  size_t number = 0;
  for (const Step &step : sequence.steps) {
    if (step.function)
      break;
    const uint64_t *values = sequence.slots.data() + step.firstSlot;
    bool isRows =
        step.kind != Step::Kind::Fill && step.kind != Step::Kind::Copy;
    bytes += values[2] * (step.kind == Step::Kind::Copy ? 1 : values[3]) *
             (isRows ? std::max<uint64_t>(values[7], 1) : 1);
    ++number;
  }
  return bytes >= muchBytes && number < sequence.steps.size() ? number : 0;
}

/// Makes the schedule again where parameters have changed that matter for it.
void DeviceQueue::Program::schedule() {
  const std::vector<uint64_t> &slots = sequence.slots;
  bool isFirst = plain.units.empty();
  if (isFirst)
    for (const Step &step : sequence.steps) {
      std::vector<size_t> used;
      if (!step.function) {
        used.resize(step.numSlots);
        std::iota(used.begin(), used.end(), size_t(0));
      } else if (step.function->footprint) {
        for (const Footprint::Line &line : step.function->footprint->lines) {
          used.push_back(static_cast<size_t>(line.access.slot));
          for (const DeviceAccess::Term &term : line.access.terms)
            used.push_back(static_cast<size_t>(term.slot));
        }
        std::sort(used.begin(), used.end());
        used.erase(std::unique(used.begin(), used.end()), used.end());
      }
      for (size_t slot : used)
        if (slot < step.numSlots)
          decisiveSlots.push_back(step.firstSlot + slot);
    }
  std::vector<uint64_t> values;
  values.reserve(decisiveSlots.size());
  for (size_t slot : decisiveSlots)
    values.push_back(slots[slot]);
  if (!isFirst && values == decisiveValues)
    return;
  decisiveValues = std::move(values);
  std::vector<StepMemory> memory;
  memory.reserve(sequence.steps.size() - numBefore);
  for (size_t i = numBefore; i < sequence.steps.size(); ++i)
    memory.push_back(memoryOf(sequence.steps[i]));
  numUnknown = static_cast<size_t>(
      std::count_if(memory.begin(), memory.end(),
                    [](const StepMemory &step) { return !step.isKnown; }));
  if (isFirst)
    for (size_t i = numBefore; i < sequence.steps.size(); ++i)
      plain.units.push_back({i, 1, -1});
  plain.order = ProgramSchedule(memory);
  if (!chosen || ways[current].hasTiles)
    scheduleTiles(memory);
}

/// Its header stands in front of the table of a program.
static constexpr int64_t headerBytes = TAI_PROGRAM_HEADER;

/// Makes what stands for the sequence on the device hold its present slots.
Status DeviceQueue::Program::update(Way &way) {
  if (way.isGraph())
    return capture(way);
  schedule();
  std::vector<LoopStep> steps;
  if (!way.hasTiles || !tiled.units.empty())
    steps = listSteps(way);
  std::vector<uint64_t> table;
  if (steps.empty() || !way.loops.pack(steps, way.words, table)) {
    // Parameters do not change as they did: without loops any will do.
    way.hasTiles = false;
    steps = listSteps(way);
    ProgramLoops rows(steps, /*useLoops=*/false);
    if (Status made = makeKernel(way, std::move(rows)); !made)
      return made;
    way.loops.pack(steps, way.words, table);
  }
  return updateTable(way, table);
}

Status DeviceQueue::Program::updateTable(Way &way,
                                         const std::vector<uint64_t> &table) {
  auto bytes = static_cast<int64_t>(table.size() * sizeof(uint64_t));
  Status status;
  // Without loops there are more rows than before.
  if (way.table && bytes > way.tableBytes) {
    device.free(way.table);
    way.table = 0;
  }
  if (!way.table) {
    // The loops ask for the row behind the last one of a list, too.
    constexpr int64_t spareBytes = 1024;
    status = device.allocate(headerBytes + bytes + spareBytes, way.table);
    way.tableBytes = bytes;
    uint64_t zero = 0;
    if (status)
      status = device.fill(way.table, &zero, 8, headerBytes / 8);
    if (status && areStepsTimed()) {
      auto words = static_cast<int64_t>(plain.units.size() + 1);
      if (!way.clocks)
        status = device.allocate(words * 8, way.clocks);
      if (status)
        status = device.fill(way.clocks, &zero, 8, words);
      if (status)
        status = device.copyIn(way.table + TAI_PROGRAM_CLOCKS, &way.clocks, 8);
    }
  }
  if (status && bytes > 0)
    status = device.copyIn(way.table + headerBytes, table.data(), bytes);
  return status;
}

Status DeviceQueue::Program::makeCurrent(Way &way) {
  if (way.isCurrent)
    return Status::success();
  Status status = update(way);
  way.isCurrent = bool(status);
  return status;
}

Status DeviceQueue::Program::launch(Way &way) {
  Status status = makeCurrent(way);
  if (!status)
    return status;
  if (way.isGraph())
    return device.run(*way.graph);
  StepRunner runner(device);
  return runKernel(way, runner);
}

/// What is too large for its few threads comes first.
Status DeviceQueue::Program::runKernel(Way &way, StepRunner &runner) {
  Status status;
  for (size_t i = 0; status && i < numBefore; ++i)
    status = runner.run(sequence, sequence.steps[i]);
  if (status)
    status = runner.finish();
  if (!status)
    return status;
  std::vector<uint64_t> slots = {way.table + headerBytes, way.loops.getStride(),
                                 way.table};
  slots.insert(slots.end(), way.words.begin(), way.words.end());
  return device.launch(*way.function, way.shape, slots.data(),
                       static_cast<int>(slots.size()));
}

//===----------------------------------------------------------------------===//
// Choosing
//===----------------------------------------------------------------------===//

Status DeviceQueue::Program::runTimed(Way &way) {
  using Clock = std::chrono::steady_clock;
  Status status = makeCurrent(way);
  if (status)
    status = device.synchronize();
  auto start = Clock::now();
  if (status)
    status = launch(way);
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
  for (Way &way : ways)
    way.isCurrent = false;
  for (const std::unique_ptr<Led> &led : leds)
    led->isCurrent = false;
}

Status DeviceQueue::Program::run(bool same, ProgramMode mode,
                                 const ProgramMaker &programMaker) {
  noteRun(same);
  // What comes once need not be made ready for a second time.
  if (runs == 1)
    return sequence.run(device);
  if (runs == 2) {
    maker = programMaker;
    listWays(mode);
  }
  if (chosen || ways.empty())
    return current < ways.size() ? launch(ways[current]) : sequence.run(device);

  while (current < ways.size()) {
    Way &way = ways[current];
    Status status;
    if (!way.isReady)
      status = prepare(way);
    // The first of three runs brings code and table to where they are used.
    constexpr int wanted = 3;
    if (status) {
      status = tries == 0 ? launch(way) : runTimed(way);
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
      if (ways[i].refused.empty() &&
          (best == ways.size() || ways[i].measured < ways[best].measured))
        best = i;
    chosen = true;
    bool hasRun = bool(status);
    current = best;
    if (best == ways.size())
      return hasRun ? std::move(status) : sequence.run(device);
    return hasRun ? std::move(status) : launch(ways[best]);
  }
  return sequence.run(device);
}

/// Where the time of the last run went: clocks of one multiprocessor by the
/// function of a step.
std::string DeviceQueue::Program::explainClocks(const Way &way) const {
  const Schedule &schedule = scheduleOf(way);
  std::vector<uint64_t> clocks(schedule.units.size() + 1);
  if (!device.copyOut(clocks.data(), way.clocks,
                      static_cast<int64_t>(clocks.size() * 8)))
    return "";
  struct Total {
    uint64_t clocks = 0, steps = 0;
  };
  std::map<std::string, Total> totals;
  for (size_t i = 0; i < schedule.units.size(); ++i) {
    Total &total = totals[describe(schedule.unit(i))];
    total.clocks += clocks[i + 1] - clocks[i];
    ++total.steps;
  }
  uint64_t all = std::max<uint64_t>(clocks.back() - clocks.front(), 1);
  std::string text;
  for (const auto &[name, total] : totals) {
    char line[512];
    std::snprintf(line, sizeof(line),
                  "\n  %5.1f %% %7llu steps %9.0f clocks each: %s",
                  100.0 * double(total.clocks) / double(all),
                  static_cast<unsigned long long>(total.steps),
                  double(total.clocks) / double(total.steps), name.c_str());
    text += line;
  }
  return text;
}

std::string DeviceQueue::Program::explain() const {
  std::string text = std::to_string(sequence.steps.size()) + " steps, run " +
                     std::to_string(runs) + " times, " +
                     std::to_string(changes) + " of them with new parameters";
  for (size_t i = 0; i < ways.size(); ++i) {
    const Way &way = ways[i];
    char line[256];
    std::snprintf(line, sizeof(line), "; %s", nameOf(way.mode));
    text += line;
    if (way.numNodes > 0) {
      std::snprintf(line, sizeof(line), " (%zu nodes)", way.numNodes);
      text += line;
    }
    if (!way.isGraph()) {
      std::snprintf(line, sizeof(line),
                    " (%u x %u threads, %zu steps before it, %zu barriers, "
                    "%zu steps in loops)",
                    way.shape.blocks, way.shape.threads, numBefore,
                    scheduleOf(way).order.numBarriers,
                    way.loops.numLoopSteps());
      text += line;
      if (way.hasTiles)
        text += describeChains();
      if (numUnknown > 0)
        text += ", " + std::to_string(numUnknown) + " steps of unknown memory";
    }
    if (!way.refused.empty()) {
      text += ": refused: " + way.refused;
      continue;
    }
    std::snprintf(line, sizeof(line), ": %.4f ms by the model", way.predicted);
    text += line;
    if (way.measured >= 0) {
      std::snprintf(line, sizeof(line), ", %.4f ms measured", way.measured);
      text += line;
    }
    if (chosen && i == current)
      text += " (chosen)";
    if (way.clocks)
      text += explainClocks(way);
  }
  return text + explainLeads();
}

bool DeviceQueue::Program::uses(const Module &module) const {
  auto isFrom = [&](const Sequence &some) {
    return std::any_of(some.steps.begin(), some.steps.end(),
                       [&](const Step &step) {
                         return step.function && module.has(step.function);
                       });
  };
  return isFrom(sequence) ||
         std::any_of(leds.begin(), leds.end(),
                     [&](const auto &led) { return isFrom(led->lead); });
}

void DeviceQueue::Program::tellTimes(double &chosenMs, double &graphMs) const {
  if (!chosen || current >= ways.size())
    return;
  chosenMs = ways[current].measured;
  for (const Way &way : ways)
    if (way.mode == ProgramMode::Graph)
      graphMs = way.measured;
}
