//===- ProgramScheduleTest.cpp - Barriers between steps -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Steps over fields of 10 x 8 floats, 320 bytes for each row of the tape. A
// function has two parameters: the address of a field and the number of a row.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Programs/ProgramSchedule.h"
#include "gtest/gtest.h"

using namespace mlir::tai::runtime;

namespace {
constexpr auto reads = DeviceAccess::Read;
constexpr auto writes = DeviceAccess::Write;
constexpr auto sums = DeviceAccess::Sum;

/// An access to row `row` + the second parameter, at an offset of `shift`
/// bytes.
DeviceAccess at(DeviceAccess::Kind kind, int64_t row = 0, int64_t shift = 0) {
  DeviceAccess access;
  access.kind = kind;
  access.offset = 320 * row + shift;
  access.window = access.step = access.size = 4;
  access.strides = {32, 4};
  access.terms = {{1, 32, 320}};
  return access;
}

/// An access to unknown elements of a row.
DeviceAccess anyOf(DeviceAccess::Kind kind, int64_t row = 0) {
  DeviceAccess access = at(kind, row);
  access.window = 320;
  access.strides = {0, 0};
  return access;
}

FunctionAccesses function(std::vector<DeviceAccess> accesses,
                          std::vector<int64_t> extents = {10, 8}) {
  return {true, std::move(extents), std::move(accesses), {}, {}};
}

class ProgramSchedules : public ::testing::Test {
protected:
  StepMemory step(const FunctionAccesses &accesses, uint64_t field,
                  uint64_t row = 0) {
    footprints.push_back(std::make_unique<Footprint>(accesses));
    uint64_t slots[] = {field, row};
    return StepMemory::ofLaunch(footprints.back().get(), slots, 2);
  }
  StepRelation relate(const FunctionAccesses &a, const FunctionAccesses &b,
                      uint64_t rowA = 0, uint64_t rowB = 0) {
    return getRelation(step(a, 4096, rowA), step(b, 4096, rowB));
  }
  std::vector<std::unique_ptr<Footprint>> footprints;
};
} // namespace

TEST_F(ProgramSchedules, ReadersNeedNothing) {
  EXPECT_EQ(relate(function({anyOf(reads)}), function({at(reads)})),
            StepRelation::None);
}

TEST_F(ProgramSchedules, RowsAreApart) {
  EXPECT_EQ(relate(function({anyOf(writes)}), function({anyOf(reads)}), 3, 4),
            StepRelation::None);
  EXPECT_EQ(relate(function({anyOf(writes)}), function({anyOf(reads)}), 3, 3),
            StepRelation::Barrier);
  EXPECT_EQ(
      relate(function({anyOf(writes, 1)}), function({anyOf(reads)}), 3, 4),
      StepRelation::Barrier);
}

TEST_F(ProgramSchedules, ThreadsKeepTheirElements) {
  EXPECT_EQ(relate(function({at(writes)}), function({at(reads), at(writes)})),
            StepRelation::SameThread);
  // Another thread wrote the neighbouring element.
  EXPECT_EQ(relate(function({at(writes)}), function({at(reads, 0, 4)})),
            StepRelation::Barrier);
  EXPECT_EQ(relate(function({at(writes)}), function({at(reads, 0, 32)})),
            StepRelation::Barrier);
  EXPECT_EQ(relate(function({at(writes)}), function({at(reads), anyOf(reads)})),
            StepRelation::Barrier);
}

TEST_F(ProgramSchedules, OtherLoopsHaveOtherThreads) {
  // In a loop over fewer rows of the same length, the same threads run row 2;
  // in a loop over shorter rows, other threads do.
  EXPECT_EQ(relate(function({at(writes)}), function({at(reads)}, {5, 8})),
            StepRelation::SameThread);
  EXPECT_EQ(relate(function({at(writes)}), function({at(reads)}, {10, 4})),
            StepRelation::Barrier);
  DeviceAccess transposed = at(reads);
  transposed.strides = {4, 40};
  EXPECT_EQ(relate(function({at(writes)}), function({transposed}, {8, 10})),
            StepRelation::Barrier);
  FunctionAccesses strange = function({at(reads)});
  strange.isGridStride = false;
  EXPECT_EQ(relate(function({at(writes)}), strange), StepRelation::Barrier);
}

TEST_F(ProgramSchedules, DenseMemoryIsOneDimension) {
  DeviceAccess flat = at(reads);
  flat.strides = {4};
  EXPECT_EQ(relate(function({at(writes)}), function({flat}, {80})),
            StepRelation::SameThread);
  StepMemory fill;
  fill.addNumbers(writes, 4096, 4, 80);
  EXPECT_EQ(getRelation(fill, step(function({at(sums)}), 4096)),
            StepRelation::SameThread);
  EXPECT_EQ(getRelation(fill, step(function({at(sums)}), 4096, 1)),
            StepRelation::None);
  StepMemory wide;
  wide.addNumbers(writes, 4096, 8, 40);
  EXPECT_EQ(getRelation(wide, step(function({at(sums)}), 4096)),
            StepRelation::Barrier);
}

TEST_F(ProgramSchedules, RowsLieBetweenThoseThatAreFilled) {
  // Fill every other row, beginning with the second.
  StepMemory fill;
  fill.addRows(writes, 4096 + 320, 640, 320, 5);
  for (uint64_t row = 0; row < 10; ++row) {
    auto expected = row % 2 == 0 ? StepRelation::None : StepRelation::Barrier;
    StepMemory touched = step(function({anyOf(reads)}), 4096, row);
    EXPECT_EQ(getRelation(fill, touched), expected) << row;
    EXPECT_EQ(getRelation(touched, fill), expected) << row;
  }
  // These accesses extend into a filled row.
  EXPECT_EQ(getRelation(fill, step(function({anyOf(reads)}), 4096 + 4, 2)),
            StepRelation::Barrier);
  EXPECT_EQ(getRelation(fill, step(function({anyOf(reads)}), 4096 - 4, 2)),
            StepRelation::Barrier);
}

TEST_F(ProgramSchedules, FieldsThatShareCellsAreApart) {
  // Cells of 8 bytes, with a float of each field.
  DeviceAccess first = at(writes), second = at(reads, 0, 4);
  for (DeviceAccess *access : {&first, &second}) {
    access->strides = {64, 8};
    access->step = 8;
  }
  EXPECT_EQ(relate(function({first}), function({second})), StepRelation::None);
  DeviceAccess neighbour = second;
  neighbour.offset += 4;
  EXPECT_EQ(relate(function({first}), function({neighbour})),
            StepRelation::Barrier);
  // Two components that one iteration accesses.
  DeviceAccess both = first;
  both.window = 8;
  both.step = 4;
  EXPECT_EQ(relate(function({both}), function({second})),
            StepRelation::SameThread);
}

TEST_F(ProgramSchedules, SumsChangePlaces) {
  EXPECT_EQ(relate(function({anyOf(sums)}), function({anyOf(sums)})),
            StepRelation::None);
  EXPECT_EQ(relate(function({anyOf(sums)}), function({anyOf(reads)})),
            StepRelation::Barrier);
}

TEST_F(ProgramSchedules, SingleIterationsAreOfOneThread) {
  EXPECT_EQ(relate(function({anyOf(writes)}, {1, 1}),
                   function({anyOf(reads)}, {1, 1})),
            StepRelation::SameThread);
  EXPECT_EQ(relate(function({anyOf(writes)}, {1, 1}), function({anyOf(reads)})),
            StepRelation::Barrier);
}

TEST_F(ProgramSchedules, WhatIsUnknownWaits) {
  EXPECT_EQ(getRelation(StepMemory(), step(function({at(reads)}), 4096)),
            StepRelation::Barrier);
  EXPECT_EQ(getRelation(step(function({}), 4096), StepMemory()),
            StepRelation::Barrier);
  // A 32-bit product may have wrapped.
  DeviceAccess product = at(reads);
  product.unit = 4;
  EXPECT_TRUE(step(function({product}), 4096, 10).isKnown);
  EXPECT_FALSE(step(function({product}), 4096, 1 << 24).isKnown);
}

TEST_F(ProgramSchedules, StepsFillEarlierGroups) {
  // Two chains over two fields, one after the other.
  std::vector<StepMemory> steps;
  for (uint64_t field : {4096, 1 << 20})
    for (uint64_t row : {0, 1, 2})
      steps.push_back(
          step(function({anyOf(reads), at(writes, 1)}), field, row));
  ProgramSchedule schedule(steps);
  EXPECT_EQ(schedule.order, (std::vector<uint32_t>{0, 3, 1, 4, 2, 5}));
  EXPECT_EQ(schedule.waits,
            (std::vector<bool>{false, true, false, true, false, true}));
  EXPECT_EQ(schedule.numBarriers, 2u);
}

TEST_F(ProgramSchedules, AllStepsSinceTheLastBarrierCount) {
  // The third step depends on the first step, not on the second.
  std::vector<StepMemory> steps{step(function({at(writes)}), 4096),
                                step(function({at(writes)}), 1 << 20),
                                step(function({anyOf(reads)}), 4096)};
  ProgramSchedule schedule(steps);
  EXPECT_EQ(schedule.numBarriers, 1u);
  EXPECT_EQ(schedule.order.back(), 2u);
}

TEST_F(ProgramSchedules, NothingPassesWhatIsUnknown) {
  std::vector<StepMemory> steps{step(function({at(writes)}), 4096),
                                StepMemory(),
                                step(function({at(writes)}), 1 << 20)};
  ProgramSchedule schedule(steps);
  EXPECT_EQ(schedule.order, (std::vector<uint32_t>{0, 1, 2}));
  EXPECT_EQ(schedule.numBarriers, 2u);
}

TEST_F(ProgramSchedules, ThreadsRunTheirStepsInOrder) {
  // The last step needs elements that the same thread stores in the second
  // step, and must not move before it.
  std::vector<StepMemory> steps{step(function({at(writes)}), 1 << 20),
                                step(function({at(writes)}), 4096),
                                step(function({at(reads)}), 4096)};
  ProgramSchedule schedule(steps);
  EXPECT_EQ(schedule.order, (std::vector<uint32_t>{0, 1, 2}));
  EXPECT_EQ(schedule.numBarriers, 0u);
}

TEST(FunctionAccesses, AreEncoded) {
  FunctionAccesses accesses = function({at(reads, 2, 4), anyOf(sums)});
  auto decoded = FunctionAccesses::decode(accesses.encode());
  ASSERT_TRUE(decoded);
  EXPECT_EQ(decoded->isGridStride, accesses.isGridStride);
  EXPECT_EQ(decoded->extents, accesses.extents);
  EXPECT_TRUE(decoded->accesses == accesses.accesses);
  std::vector<int64_t> words = accesses.encode();
  words.pop_back();
  EXPECT_FALSE(FunctionAccesses::decode(words));
  EXPECT_FALSE(FunctionAccesses::decode({}));
}
