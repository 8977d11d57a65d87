//===- ProgramLoopsTest.cpp - Loops in a sequence of work -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Plays the segments back, as the code of a program does, and compares the
// result with the original steps.
//
//===----------------------------------------------------------------------===//

#include "../../../../lib/Runtime/Programs/ProgramLoops.h"
#include "tai/ABI/DeviceAbi.h"
#include "gtest/gtest.h"
#include <deque>

using namespace mlir::tai::runtime;

namespace {
struct Steps {
  std::deque<std::vector<uint64_t>> slots;
  std::vector<LoopStep> steps;

  void add(uint64_t part, std::vector<uint64_t> values, bool waits = true) {
    slots.push_back(std::move(values));
    steps.push_back({TAI_FIRST_PART + part, waits, slots.back().data(),
                     slots.back().size()});
  }
};

/// All parts with their parameters, in the order in which a program runs them.
std::vector<std::vector<uint64_t>> list(const std::vector<LoopStep> &steps) {
  std::vector<std::vector<uint64_t>> result;
  for (const LoopStep &step : steps) {
    result.push_back({step.part, step.waits});
    result.back().insert(result.back().end(), step.slots,
                         step.slots + step.numSlots);
  }
  return result;
}

std::vector<std::vector<uint64_t>> play(const ProgramLoops &loops,
                                        const std::vector<LoopStep> &steps) {
  std::vector<uint64_t> words, table;
  std::vector<std::vector<uint64_t>> result;
  if (!loops.pack(steps, words, table))
    return result;
  const uint64_t *row = table.data();
  size_t next = 0;
  for (const ProgramSegment &segment : loops.allSegments()) {
    EXPECT_EQ(segment.first, next);
    next += segment.count * (segment.isLoop() ? segment.steps.size() : 1);
    for (size_t turn = 0; turn < segment.count; ++turn) {
      if (!segment.isLoop()) {
        size_t numSlots = steps[segment.first + turn].numSlots;
        result.push_back(
            {row[0] & (TAI_PART_APART - 1), (row[0] & TAI_PART_APART) == 0});
        result.back().insert(result.back().end(), row + 1, row + 1 + numSlots);
        row += loops.rowWords();
        continue;
      }
      const uint64_t *list =
          table.data() + segment.listStart + turn * segment.listWidth;
      for (const ProgramLoopStep &step : segment.steps) {
        result.push_back({step.part, step.waits});
        for (const ProgramSlot &slot : step.slots)
          result.back().push_back(
              slot.kind == ProgramSlot::Listed ? list[slot.word]
              : slot.kind == ProgramSlot::Fixed
                  ? words[slot.word]
                  : words[slot.word] + turn * words[slot.word + 1]);
      }
    }
  }
  return result;
}

/// Two kernels in each step: one with an address and a number that counts down,
/// the other with a number that follows no rule.
Steps simulate(int count, uint64_t address) {
  Steps steps;
  steps.add(0, {address});
  for (int i = 0; i < count; ++i) {
    steps.add(1, {address, static_cast<uint64_t>(count - i)});
    steps.add(2, {address, static_cast<uint64_t>(i * i)}, i % 2 == 0);
  }
  steps.add(3, {address, 7, 8});
  return steps;
}
} // namespace

TEST(ProgramLoops, StepsThatRepeatBecomeALoop) {
  Steps steps;
  steps.add(0, {1});
  for (uint64_t i = 0; i < 10; ++i) {
    steps.add(1, {64, 9 - i});
    steps.add(2, {64, i * i});
  }
  ProgramLoops loops(steps.steps, true);
  ASSERT_EQ(loops.allSegments().size(), 2u);
  EXPECT_FALSE(loops.allSegments()[0].isLoop());
  const ProgramSegment &loop = loops.allSegments()[1];
  ASSERT_TRUE(loop.isLoop());
  EXPECT_EQ(loop.count, 10u);
  EXPECT_EQ(loop.listWidth, 1u);
  // The address is stored once, and so is the number that counts down, with its
  // step.
  EXPECT_EQ(loops.numWords(), 3u);
  EXPECT_EQ(loops.numLoopSteps(), 20u);
  EXPECT_EQ(play(loops, steps.steps), list(steps.steps));
}

TEST(ProgramLoops, OtherParametersOfTheSameKindFit) {
  Steps one = simulate(12, 4096), other = simulate(12, 8192);
  ProgramLoops loops(one.steps, true);
  EXPECT_EQ(play(loops, one.steps), list(one.steps));
  EXPECT_EQ(play(loops, other.steps), list(other.steps));
}

TEST(ProgramLoops, ParametersThatChangeInAnotherWayDoNot) {
  Steps one = simulate(12, 4096), other = simulate(12, 4096);
  // Change a number in the second of three rounds.
  other.slots[3][1] += 1;
  ProgramLoops loops(one.steps, true);
  std::vector<uint64_t> words, table;
  EXPECT_FALSE(loops.pack(other.steps, words, table));
  ProgramLoops rows(other.steps, false);
  EXPECT_EQ(rows.numLoopSteps(), 0u);
  EXPECT_EQ(play(rows, other.steps), list(other.steps));
}

TEST(ProgramLoops, ABarrierThatIsNewDoesNotFit) {
  Steps one, other;
  for (uint64_t i = 0; i < 8; ++i) {
    one.add(0, {i}, false);
    other.add(0, {i}, i == 5);
  }
  ProgramLoops loops(one.steps, true);
  EXPECT_EQ(loops.numLoopSteps(), 8u);
  std::vector<uint64_t> words, table;
  EXPECT_FALSE(loops.pack(other.steps, words, table));
}

TEST(ProgramLoops, FewRepetitionsStayInTheTable) {
  Steps steps;
  for (uint64_t i = 0; i < 3; ++i) {
    steps.add(0, {i});
    steps.add(1, {i});
  }
  ProgramLoops loops(steps.steps, true);
  EXPECT_EQ(loops.numLoopSteps(), 0u);
  EXPECT_EQ(play(loops, steps.steps), list(steps.steps));
}
