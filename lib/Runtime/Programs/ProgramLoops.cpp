//===- ProgramLoops.cpp - Loops in sequences of work ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "ProgramLoops.h"
#include "tai/ABI/DeviceAbi.h"
#include "tai/Runtime/Programs/ProgramTiles.h"
#include <algorithm>
#include <unordered_map>

using namespace mlir::tai::runtime;

/// The most steps in the body of a loop: the code of longer bodies would not
/// fit the instruction caches.
static constexpr size_t longestPeriod = 64;
/// The minimum number of repetitions of some steps for which a loop in the code
/// pays.
static constexpr size_t fewestRepetitions = 4;
/// The most steps in the bodies of all loops, which limits the size of the
/// code.
static constexpr size_t mostLoopSteps = 128;

/// True if the step is a tile chain, which has no row in the step table.
static bool isChain(const LoopStep &step) {
  return step.part >= firstChainPart;
}

static bool areAlike(const LoopStep &a, const LoopStep &b) {
  return a.part == b.part && a.waits == b.waits && a.numSlots == b.numSlots;
}

/// Counts how often the `period` steps from `first` on occur one after the
/// other.
static size_t countRepetitions(const std::vector<LoopStep> &steps, size_t first,
                               size_t period) {
  size_t same = 0;
  while (first + period + same < steps.size() &&
         areAlike(steps[first + same], steps[first + period + same]))
    ++same;
  return 1 + same / period;
}

/// Returns how a parameter of a step changes from one iteration of a loop to
/// the next.
static ProgramSlot::Kind classify(const std::vector<LoopStep> &steps,
                                  size_t first, size_t period, size_t count,
                                  size_t slot) {
  if (count == 1)
    return ProgramSlot::Fixed;
  uint64_t growth =
      steps[first + period].slots[slot] - steps[first].slots[slot];
  for (size_t k = 2; k < count; ++k)
    if (steps[first + k * period].slots[slot] -
            steps[first + (k - 1) * period].slots[slot] !=
        growth)
      return ProgramSlot::Listed;
  return growth == 0 ? ProgramSlot::Fixed : ProgramSlot::Growing;
}

ProgramLoops::ProgramLoops(const std::vector<LoopStep> &steps, bool useLoops) {
  auto addRows = [&](size_t first, size_t count) {
    if (count == 0)
      return;
    if (!segments.empty() && !segments.back().isLoop()) {
      segments.back().count += count;
      return;
    }
    segments.emplace_back();
    segments.back().first = first;
    segments.back().count = count;
  };
  numSteps = steps.size();
  stride = 8;
  for (const LoopStep &step : steps)
    stride = std::max(stride, isChain(step) ? 0 : step.numSlots);
  // A row of the step table holds the part number of a step, and then the
  // parameters of the step.
  ++stride;
  size_t loopSteps = 0;
  for (size_t at = 0; at < steps.size();) {
    size_t bestPeriod = 0, bestCount = 0;
    for (size_t period = 1; useLoops && period <= longestPeriod &&
                            at + fewestRepetitions * period <= steps.size();
         ++period) {
      size_t count = countRepetitions(steps, at, period);
      if (count >= fewestRepetitions &&
          count * period > bestCount * bestPeriod) {
        bestPeriod = period;
        bestCount = count;
      }
    }
    if (bestPeriod > 0 && loopSteps + bestPeriod <= mostLoopSteps &&
        addLoop(steps, at, bestPeriod, bestCount)) {
      loopSteps += bestPeriod;
      at += bestPeriod * bestCount;
      continue;
    }
    if (!isChain(steps[at]))
      addRows(at, 1);
    else if (++loopSteps > mostLoopSteps || !addLoop(steps, at, 1, 1))
      fits = false;
    ++at;
  }
  // In the step table, the lists of loops come after the rows of single steps.
  for (ProgramSegment &segment : segments)
    tableWords += segment.isLoop() ? 0 : segment.count * stride;
  for (ProgramSegment &segment : segments)
    if (segment.isLoop()) {
      segment.listStart = tableWords;
      tableWords += segment.count * segment.listWidth;
    }
}

size_t ProgramLoops::numLoopSteps() const {
  size_t number = 0;
  for (const ProgramSegment &segment : segments)
    if (segment.isLoop())
      number += segment.steps.size() * segment.count;
  return number;
}

bool ProgramLoops::addLoop(const std::vector<LoopStep> &steps, size_t first,
                           size_t period, size_t count) {
  ProgramSegment segment;
  segment.first = first;
  segment.count = count;
  // Steps share many parameters, the addresses of fields above all, so equal
  // parameters share a word.
  std::unordered_map<uint64_t, size_t> fixedWords;
  size_t before = origins.size();
  for (size_t j = 0; j < period; ++j) {
    const LoopStep &one = steps[first + j];
    ProgramLoopStep step;
    step.part = one.part;
    step.waits = one.waits;
    for (size_t slot = 0; slot < one.numSlots; ++slot) {
      ProgramSlot::Kind kind = classify(steps, first + j, period, count, slot);
      size_t word = origins.size();
      if (kind == ProgramSlot::Listed) {
        word = segment.listWidth++;
      } else if (kind == ProgramSlot::Growing) {
        origins.push_back({first + j, slot, 0, false});
        origins.push_back({first + j, slot, first + period + j, true});
      } else {
        word = fixedWords.emplace(one.slots[slot], word).first->second;
        if (word == origins.size())
          origins.push_back({first + j, slot, 0, false});
      }
      step.slots.push_back({kind, static_cast<unsigned>(word)});
    }
    segment.steps.push_back(std::move(step));
  }
  if (origins.size() > TAI_PROGRAM_WORDS) {
    origins.resize(before);
    return false;
  }
  segments.push_back(std::move(segment));
  return true;
}

bool ProgramLoops::pack(const std::vector<LoopStep> &steps,
                        std::vector<uint64_t> &words,
                        std::vector<uint64_t> &table) const {
  words.clear();
  if (steps.size() != numSteps)
    return false;
  for (const Origin &origin : origins) {
    size_t last =
        origin.isGrowth ? std::max(origin.step, origin.next) : origin.step;
    if (origin.slot >= steps[origin.step].numSlots ||
        origin.slot >= steps[last].numSlots)
      return false;
    uint64_t value = steps[origin.step].slots[origin.slot];
    words.push_back(origin.isGrowth
                        ? steps[origin.next].slots[origin.slot] - value
                        : value);
  }
  table.assign(tableWords, 0);
  uint64_t *row = table.data();
  for (const ProgramSegment &segment : segments) {
    if (segment.isLoop()) {
      if (!packLoop(segment, steps, words, table.data() + segment.listStart))
        return false;
      continue;
    }
    for (size_t i = 0; i < segment.count; ++i, row += stride) {
      const LoopStep &step = steps[segment.first + i];
      row[0] = step.part | (step.waits ? 0 : TAI_PART_APART);
      std::copy_n(step.slots, step.numSlots, row + 1);
    }
  }
  return true;
}

/// Writes the parameter list of a loop; false if the steps or other parameters
/// do not fit the loop.
bool ProgramLoops::packLoop(const ProgramSegment &segment,
                            const std::vector<LoopStep> &steps,
                            const std::vector<uint64_t> &words,
                            uint64_t *list) const {
  for (size_t turn = 0; turn < segment.count; ++turn, list += segment.listWidth)
    for (size_t j = 0; j < segment.steps.size(); ++j) {
      const ProgramLoopStep &step = segment.steps[j];
      const LoopStep &given =
          steps[segment.first + turn * segment.steps.size() + j];
      if (given.part != step.part || (given.waits && !step.waits))
        return false;
      for (size_t slot = 0; slot < step.slots.size(); ++slot) {
        const ProgramSlot &from = step.slots[slot];
        uint64_t value = given.slots[slot];
        if (from.kind == ProgramSlot::Listed)
          list[from.word] = value;
        else if (from.kind == ProgramSlot::Fixed && words[from.word] != value)
          return false;
        else if (from.kind == ProgramSlot::Growing &&
                 words[from.word] + turn * words[from.word + 1] != value)
          return false;
      }
    }
  return true;
}
