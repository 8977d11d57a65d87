//===- ProgramScheduleTest.cpp - Where steps wait for each other ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Steps over fields of 10 x 8 floats, 320 bytes a row of the tape. A function
// has two parameters: the address of a field and a row.
//
//===----------------------------------------------------------------------===//

#include "../../../lib/Runtime/Queue/ProgramSchedule.h"
#include "gtest/gtest.h"

using namespace mlir::tai::runtime;

namespace {
constexpr auto Read = DeviceAccess::Read;
constexpr auto Write = DeviceAccess::Write;
constexpr auto Sum = DeviceAccess::Sum;

/// An access to row `row` + the second parameter, `shift` bytes further on.
DeviceAccess at(DeviceAccess::Kind kind, int64_t row = 0, int64_t shift = 0) {
  DeviceAccess access;
  access.kind = kind;
  access.offset = 320 * row + shift;
  access.window = access.step = access.size = 4;
  access.strides = {32, 4};
  access.terms = {{1, 32, 320}};
  return access;
}

/// Any element of a row.
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
  StepMemory step(FunctionAccesses accesses, uint64_t field, uint64_t row = 0) {
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
  EXPECT_EQ(relate(function({anyOf(Read)}), function({at(Read)})),
            StepRelation::None);
}

TEST_F(ProgramSchedules, RowsAreApart) {
  EXPECT_EQ(relate(function({anyOf(Write)}), function({anyOf(Read)}), 3, 4),
            StepRelation::None);
  EXPECT_EQ(relate(function({anyOf(Write)}), function({anyOf(Read)}), 3, 3),
            StepRelation::Barrier);
  EXPECT_EQ(relate(function({anyOf(Write, 1)}), function({anyOf(Read)}), 3, 4),
            StepRelation::Barrier);
}

TEST_F(ProgramSchedules, ThreadsKeepTheirElements) {
  EXPECT_EQ(relate(function({at(Write)}), function({at(Read), at(Write)})),
            StepRelation::SameThread);
  // A neighbour was another thread's.
  EXPECT_EQ(relate(function({at(Write)}), function({at(Read, 0, 4)})),
            StepRelation::Barrier);
  EXPECT_EQ(relate(function({at(Write)}), function({at(Read, 0, 32)})),
            StepRelation::Barrier);
  EXPECT_EQ(relate(function({at(Write)}), function({at(Read), anyOf(Read)})),
            StepRelation::Barrier);
}

TEST_F(ProgramSchedules, OtherLoopsHaveOtherThreads) {
  // Row 2 is of the same threads in a loop over fewer rows, but not over
  // shorter ones.
  EXPECT_EQ(relate(function({at(Write)}), function({at(Read)}, {5, 8})),
            StepRelation::SameThread);
  EXPECT_EQ(relate(function({at(Write)}), function({at(Read)}, {10, 4})),
            StepRelation::Barrier);
  DeviceAccess transposed = at(Read);
  transposed.strides = {4, 40};
  EXPECT_EQ(relate(function({at(Write)}), function({transposed}, {8, 10})),
            StepRelation::Barrier);
  FunctionAccesses strange = function({at(Read)});
  strange.isGridStride = false;
  EXPECT_EQ(relate(function({at(Write)}), strange), StepRelation::Barrier);
}

TEST_F(ProgramSchedules, DenseMemoryIsOneDimension) {
  DeviceAccess flat = at(Read);
  flat.strides = {4};
  EXPECT_EQ(relate(function({at(Write)}), function({flat}, {80})),
            StepRelation::SameThread);
  StepMemory fill;
  fill.addNumbers(Write, 4096, 4, 80);
  EXPECT_EQ(getRelation(fill, step(function({at(Sum)}), 4096)),
            StepRelation::SameThread);
  EXPECT_EQ(getRelation(fill, step(function({at(Sum)}), 4096, 1)),
            StepRelation::None);
  StepMemory wide;
  wide.addNumbers(Write, 4096, 8, 40);
  EXPECT_EQ(getRelation(wide, step(function({at(Sum)}), 4096)),
            StepRelation::Barrier);
}

TEST_F(ProgramSchedules, RowsLieBetweenThoseThatAreFilled) {
  // Every other row, the second one first.
  StepMemory fill;
  fill.addRows(Write, 4096 + 320, 640, 320, 5);
  for (uint64_t row = 0; row < 10; ++row) {
    auto expected = row % 2 == 0 ? StepRelation::None : StepRelation::Barrier;
    StepMemory touched = step(function({anyOf(Read)}), 4096, row);
    EXPECT_EQ(getRelation(fill, touched), expected) << row;
    EXPECT_EQ(getRelation(touched, fill), expected) << row;
  }
  // Not all of it lies between two.
  EXPECT_EQ(getRelation(fill, step(function({anyOf(Read)}), 4096 + 4, 2)),
            StepRelation::Barrier);
  EXPECT_EQ(getRelation(fill, step(function({anyOf(Read)}), 4096 - 4, 2)),
            StepRelation::Barrier);
}

TEST_F(ProgramSchedules, FieldsThatShareCellsAreApart) {
  // Cells of 8 bytes with a float of either field.
  DeviceAccess first = at(Write), second = at(Read, 0, 4);
  for (DeviceAccess *access : {&first, &second}) {
    access->strides = {64, 8};
    access->step = 8;
  }
  EXPECT_EQ(relate(function({first}), function({second})), StepRelation::None);
  DeviceAccess neighbour = second;
  neighbour.offset += 4;
  EXPECT_EQ(relate(function({first}), function({neighbour})),
            StepRelation::Barrier);
  // Two components of one iteration.
  DeviceAccess both = first;
  both.window = 8;
  both.step = 4;
  EXPECT_EQ(relate(function({both}), function({second})),
            StepRelation::SameThread);
}

TEST_F(ProgramSchedules, SumsChangePlaces) {
  EXPECT_EQ(relate(function({anyOf(Sum)}), function({anyOf(Sum)})),
            StepRelation::None);
  EXPECT_EQ(relate(function({anyOf(Sum)}), function({anyOf(Read)})),
            StepRelation::Barrier);
}

TEST_F(ProgramSchedules, SingleIterationsAreOfOneThread) {
  EXPECT_EQ(
      relate(function({anyOf(Write)}, {1, 1}), function({anyOf(Read)}, {1, 1})),
      StepRelation::SameThread);
  EXPECT_EQ(relate(function({anyOf(Write)}, {1, 1}), function({anyOf(Read)})),
            StepRelation::Barrier);
}

TEST_F(ProgramSchedules, WhatIsUnknownWaits) {
  EXPECT_EQ(getRelation(StepMemory(), step(function({at(Read)}), 4096)),
            StepRelation::Barrier);
  EXPECT_EQ(getRelation(step(function({}), 4096), StepMemory()),
            StepRelation::Barrier);
  // A product in 32 bits that may have wrapped.
  DeviceAccess product = at(Read);
  product.unit = 4;
  EXPECT_TRUE(step(function({product}), 4096, 10).isKnown);
  EXPECT_FALSE(step(function({product}), 4096, 1 << 24).isKnown);
}

TEST_F(ProgramSchedules, StepsFillEarlierGroups) {
  // Two chains over two fields, one after the other.
  std::vector<StepMemory> steps;
  for (uint64_t field : {4096, 1 << 20})
    for (uint64_t row : {0, 1, 2})
      steps.push_back(step(function({anyOf(Read), at(Write, 1)}), field, row));
  ProgramSchedule schedule(steps);
  EXPECT_EQ(schedule.order, (std::vector<uint32_t>{0, 3, 1, 4, 2, 5}));
  EXPECT_EQ(schedule.waits,
            (std::vector<bool>{false, true, false, true, false, true}));
  EXPECT_EQ(schedule.numBarriers, 2u);
}

TEST_F(ProgramSchedules, AllStepsSinceTheLastBarrierCount) {
  // The third step does not meet the second one, but the first.
  std::vector<StepMemory> steps{step(function({at(Write)}), 4096),
                                step(function({at(Write)}), 1 << 20),
                                step(function({anyOf(Read)}), 4096)};
  ProgramSchedule schedule(steps);
  EXPECT_EQ(schedule.numBarriers, 1u);
  EXPECT_EQ(schedule.order.back(), 2u);
}

TEST_F(ProgramSchedules, NothingPassesWhatIsUnknown) {
  std::vector<StepMemory> steps{step(function({at(Write)}), 4096), StepMemory(),
                                step(function({at(Write)}), 1 << 20)};
  ProgramSchedule schedule(steps);
  EXPECT_EQ(schedule.order, (std::vector<uint32_t>{0, 1, 2}));
  EXPECT_EQ(schedule.numBarriers, 2u);
}

TEST_F(ProgramSchedules, ThreadsRunTheirStepsInOrder) {
  // The last step needs the second one's elements from the same thread, and
  // must not come before it.
  std::vector<StepMemory> steps{step(function({at(Write)}), 1 << 20),
                                step(function({at(Write)}), 4096),
                                step(function({at(Read)}), 4096)};
  ProgramSchedule schedule(steps);
  EXPECT_EQ(schedule.order, (std::vector<uint32_t>{0, 1, 2}));
  EXPECT_EQ(schedule.numBarriers, 0u);
}

TEST(FunctionAccesses, AreEncoded) {
  FunctionAccesses accesses = function({at(Read, 2, 4), anyOf(Sum)});
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
