//===- DeviceProgramTiles.cpp - Chains of a sequence ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The second schedule of a program, in which launches that can share tiles
// stand together as one step.
//
//===----------------------------------------------------------------------===//

#include "DeviceProgram.h"
#include "tai/ABI/DeviceAbi.h"
#include <algorithm>
#include <set>
#include <unordered_map>

using namespace mlir::tai::runtime;

bool DeviceQueue::Program::canHaveTiles() const {
  return maker && areAllPartsKnown() &&
         (device.limits().hasGridBarriers ||
          device.kind() == DeviceKind::Emulated);
}

bool DeviceQueue::Program::areAllPartsKnown() const {
  return std::all_of(
      sequence.steps.begin(), sequence.steps.end(), [](const Step &step) {
        return step.kind != Step::Kind::Launch ||
               (step.function->bitcode && !step.function->bitcode->empty());
      });
}

/// What the launches of a chain touch, whichever thread does.
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

void DeviceQueue::Program::scheduleTiles(
    const std::vector<StepMemory> &memory) {
  tiled = Schedule();
  if (!canHaveTiles())
    return;
  // Half of what a block has for sure: the library has some, too.
  constexpr int64_t mostBytes = 40 << 10, mostCells = 2048;
  TileLimits limits{device.limits().multiprocessors, mostBytes, mostCells};
  std::unordered_map<const Function *, uint64_t> numbers;
  std::vector<const Function *> parts = listParts();
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
  // Tiles take a grid of their size: they must save many barriers.
  if (!hasChains || 4 * tiled.order.numBarriers > 3 * plain.order.numBarriers)
    tiled = Schedule();
}

/// Adds the functions of iterations, whose numbers follow those of the others,
/// and the chains that call them.
void DeviceQueue::Program::addTiles(ProgramPlan &plan) const {
  plan.chains = chains;
  std::vector<const Function *> parts = listParts();
  std::set<uint64_t> used;
  for (const TileChain &chain : chains)
    for (const TileStage &stage : chain.stages)
      used.insert(stage.part);
  for (const Function *part : parts) {
    ProgramPart tile{nullptr, "", /*isInTable=*/false, /*isTile=*/true};
    if (used.count(TAI_FIRST_PART + plan.parts.size()) != 0) {
      tile.bitcode = part->bitcode.get();
      tile.function = part->name + tileSuffix;
    }
    plan.parts.push_back(std::move(tile));
  }
}

std::string DeviceQueue::Program::describe(const Unit &unit) const {
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

std::string DeviceQueue::Program::describeChains() const {
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
