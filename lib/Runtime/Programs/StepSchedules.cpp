//===- StepSchedules.cpp - The schedules of a sequence --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "StepSchedules.h"
#include "tai/ABI/DeviceAbi.h"
#include <algorithm>
#include <numeric>
#include <set>
#include <unordered_map>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::programs;

/// The number of initial fills and copies to run before the program, which
/// often has few threads; 0 unless they move much memory, as the zeroing of
/// gradients of all time steps does.
size_t StepSchedules::countStepsBefore() const {
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

void StepSchedules::listDecisiveSlots() {
  for (const Step &step : sequence.steps) {
    std::vector<size_t> used;
    if (!step.function) {
      used.resize(step.numSlots);
      std::iota(used.begin(), used.end(), size_t(0));
    } else if (step.function->footprint) {
      for (const Footprint::Line &line : step.function->footprint->lines) {
        used.push_back(static_cast<size_t>(line.access.slot));
        for (const LaunchTerm &term : line.access.terms)
          used.push_back(static_cast<size_t>(term.slot));
      }
      std::sort(used.begin(), used.end());
      used.erase(std::unique(used.begin(), used.end()), used.end());
    }
    for (size_t slot : used)
      if (slot < step.numSlots)
        decisiveSlots.push_back(step.firstSlot + slot);
  }
}

void StepSchedules::make(bool withTiles) {
  wantsTiles = withTiles;
  numBefore = countStepsBefore();
  listDecisiveSlots();
  for (size_t i = numBefore; i < sequence.steps.size(); ++i)
    plain.units.push_back({i, 1, -1});
  update();
}

void StepSchedules::update() {
  std::vector<uint64_t> values;
  values.reserve(decisiveSlots.size());
  for (size_t slot : decisiveSlots)
    values.push_back(sequence.slots[slot]);
  bool isFirst = plain.order.order.empty();
  if (!isFirst && values == decisiveValues)
    return;
  decisiveValues = std::move(values);
  std::vector<StepMemory> memory;
  memory.reserve(sequence.steps.size() - numBefore);
  for (size_t i = numBefore; i < sequence.steps.size(); ++i)
    memory.push_back(sequence.memoryOf(sequence.steps[i]));
  numUnknown = static_cast<size_t>(
      std::count_if(memory.begin(), memory.end(),
                    [](const StepMemory &step) { return !step.isKnown; }));
  plain.order = ProgramSchedule(memory);
  if (wantsTiles)
    makeTiled(memory);
}

//===----------------------------------------------------------------------===//
// Tiles
//===----------------------------------------------------------------------===//

/// The memory that the launches of a tile chain access, by any thread.
static StepMemory unite(const std::vector<StepMemory> &memory, size_t first,
                        size_t count) {
  StepMemory all;
  all.isKnown = true;
  for (size_t i = first; i < first + count; ++i) {
    all.isKnown &= memory[i].isKnown;
    for (auto [from, to] : {std::pair(&memory[i].reads, &all.reads),
                            std::pair(&memory[i].changes, &all.changes)})
      for (StepMemory::Piece piece : *from) {
        piece.map = nullptr;
        to->push_back(piece);
      }
  }
  return all;
}

void StepSchedules::makeTiled(const std::vector<StepMemory> &memory) {
  tiled = Schedule();
  // The limit for tiles: less than the 48 KiB of shared memory that every block
  // can have, since the device library uses some, too.
  constexpr int64_t mostBytes = 40 << 10, mostCells = 2048;
  TileLimits limits{device.limits().multiprocessors, mostBytes, mostCells};
  std::unordered_map<const Function *, uint64_t> numbers;
  std::vector<const Function *> parts = sequence.listParts();
  for (const Function *part : parts)
    numbers.emplace(part, TAI_FIRST_PART + parts.size() + numbers.size());
  std::vector<ChainStep> steps;
  for (size_t i = numBefore; i < sequence.steps.size(); ++i) {
    const Step &step = sequence.steps[i];
    ChainStep chainStep;
    if (step.function) {
      chainStep.function = step.function->accesses.get();
      chainStep.slots = sequence.slots.data() + step.firstSlot;
      chainStep.numSlots = step.numSlots;
      chainStep.part = numbers.at(step.function);
    }
    steps.push_back(chainStep);
  }
  std::vector<StepMemory> united;
  bool hasChains = false;
  for (size_t i = 0; i < steps.size();) {
    Unit unit{numBefore + i, 1, -1};
    if (auto found = findChain(&steps[i], steps.size() - i, limits)) {
      auto known = std::find(chains.begin(), chains.end(), found->first);
      unit.chain = static_cast<int>(known - chains.begin());
      unit.count = found->second;
      if (known == chains.end())
        chains.push_back(std::move(found->first));
      hasChains = true;
    }
    united.push_back(unit.chain < 0 ? memory[i] : unite(memory, i, unit.count));
    tiled.units.push_back(unit);
    i += unit.count;
  }
  if (hasChains)
    tiled.order = ProgramSchedule(united);
  // Tiles need a grid with a block for each tile, so they must save many
  // barriers to be worth it.
  if (!hasChains || 4 * tiled.order.numBarriers > 3 * plain.order.numBarriers)
    tiled = Schedule();
}

LaunchShape StepSchedules::tileShape() const {
  int64_t blocks = 1, cells = 1;
  for (const Unit &unit : tiled.units)
    if (unit.chain >= 0) {
      const TileChain &chain = chains[static_cast<size_t>(unit.chain)];
      blocks = std::max(blocks, chain.numTiles());
      cells = std::max(cells, chain.mostCells());
    }
  LaunchShape shape;
  shape.blocks = static_cast<unsigned>(blocks);
  shape.threads = static_cast<unsigned>(cells);
  return shape;
}

void StepSchedules::addTiles(ProgramPlan &plan) const {
  plan.chains = chains;
  std::vector<const Function *> parts = sequence.listParts();
  std::set<uint64_t> used;
  for (const TileChain &chain : chains)
    for (const TileStage &stage : chain.stages)
      used.insert(stage.part);
  for (const Function *part : parts) {
    ProgramPart tile{nullptr, "", /*isInTable=*/false, /*isTile=*/true};
    if (used.count(TAI_FIRST_PART + plan.parts.size()) != 0) {
      tile.bitcode = part->bitcode;
      tile.function = part->name + tileSuffix;
    }
    plan.parts.push_back(std::move(tile));
  }
}

//===----------------------------------------------------------------------===//
// Programs
//===----------------------------------------------------------------------===//

std::vector<LoopStep> StepSchedules::listSteps(bool withTiles) const {
  const Schedule &schedule = get(withTiles);
  std::unordered_map<const Function *, uint64_t> numbers;
  for (const Function *part : sequence.listParts())
    numbers.emplace(part, TAI_FIRST_PART + numbers.size());
  auto partOf = [](const Step &step) -> uint64_t {
    switch (step.kind) {
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
  };
  std::vector<LoopStep> steps;
  steps.reserve(schedule.units.size());
  for (size_t i = 0; i < schedule.units.size(); ++i) {
    const Unit &unit = schedule.unit(i);
    const Step &step = sequence.steps[unit.first];
    LoopStep listed;
    listed.part = step.function ? numbers.at(step.function) : partOf(step);
    listed.waits = schedule.order.waits[i];
    listed.slots = sequence.slots.data() + step.firstSlot;
    listed.numSlots = step.numSlots;
    if (unit.chain >= 0) {
      // The parameter slots of the launches of a tile chain are consecutive.
      const Step &last = sequence.steps[unit.first + unit.count - 1];
      listed.part = firstChainPart + static_cast<uint64_t>(unit.chain);
      listed.numSlots = last.firstSlot + last.numSlots - step.firstSlot;
    }
    steps.push_back(listed);
  }
  return steps;
}

std::string StepSchedules::describe(const Unit &unit) const {
  auto nameOf = [](const Step &step) -> std::string {
    if (step.function)
      return step.function->name;
    return step.kind == Step::Kind::Fill || step.kind == Step::Kind::FillRows
               ? "fill"
               : "copy";
  };
  std::string text;
  for (size_t i = 0; i < unit.count; ++i) {
    const Step &step = sequence.steps[unit.first + i];
    size_t same = 1;
    while (i + same < unit.count &&
           sequence.steps[unit.first + i + same].function == step.function)
      ++same;
    text += text.empty() ? "" : ", ";
    text += nameOf(step);
    if (same > 1)
      text += " x " + std::to_string(same);
    i += same - 1;
  }
  return text;
}

std::string StepSchedules::describeChains() const {
  std::vector<size_t> times(chains.size(), 0);
  std::vector<const Unit *> first(chains.size(), nullptr);
  for (const Unit &unit : tiled.units)
    if (unit.chain >= 0) {
      auto chain = static_cast<size_t>(unit.chain);
      if (times[chain]++ == 0)
        first[chain] = &unit;
    }
  std::string text;
  for (size_t i = 0; i < chains.size(); ++i) {
    if (times[i] == 0)
      continue;
    const TileChain &chain = chains[i];
    text += ", " + std::to_string(times[i]) + " times in " +
            std::to_string(chain.numTiles()) + " tiles of ";
    for (size_t d = 0; d < chain.tile.size(); ++d)
      text += (d == 0 ? "" : " x ") + std::to_string(chain.tile[d]);
    text += " with up to " + std::to_string(chain.mostCells()) +
            " cells: " + describe(*first[i]);
  }
  return text;
}
