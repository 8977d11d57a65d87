//===- KernelAccessesTest.cpp - Accesses of launches ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/KernelAccesses.h"
#include "../Utils/ContextTest.h"
#include "mlir/Parser/Parser.h"
#include "tai/Analysis/LoopLevels.h"
#include "tai/Analysis/ToBeRecorded.h"
#include "tai/Analysis/ValueFlows.h"
#include "gtest/gtest.h"

using namespace mlir;
using namespace mlir::tai;
using Kind = runtime::AccessKind;

namespace {
class LaunchAccessesTest : public ContextTest {
protected:
  /// Parses a module with kernel @k, fields @x and @y of 8 by 16, and @s with
  /// sparse cells.
  void parse(StringRef kernels) {
    std::string text = R"(
      !t = !tai.root<dense<[i: 8, j: 16], {x: f32, y: f32}>>
      tai.tree @t : !t
      tai.field @x = @t["x"] : f32, rank 2
      tai.field @y = @t["y"] : f32, rank 2
      !u = !tai.root<pointer<[i: 8], {s: f32}>>
      tai.tree @u : !u
      tai.field @s = @u["s"] : f32, rank 1
    )" + kernels.str();
    module = parseSourceString<ModuleOp>(text, &context);
    ASSERT_TRUE(module);
    kernel = module->lookupSymbol<KernelOp>("k");
  }

  OwningOpRef<ModuleOp> module;
  KernelOp kernel;
};
} // namespace

TEST_F(LaunchAccessesTest, IndicesFromArgumentsAreToldFromTheLaunch) {
  parse(R"(
    tai.kernel @k(%v: f32, %t: i32) {
      %c1 = arith.constant 1 : index
      %row = arith.index_cast %t : i32 to index
      %next = arith.addi %row, %c1 : index
      %c0 = arith.constant 0 : index
      %c16 = arith.constant 16 : index
      tai.parallel_for (%j) = (%c0) to (%c16) {
        %0 = tai.load @x[%row, %j] : f32
        tai.store %0, @x[%next, %j] : f32
      }
      tai.return
    })");
  std::vector<NamedAccess> accesses = listAccesses(kernel);
  ASSERT_EQ(accesses.size(), 2u);
  EXPECT_EQ(accesses[0].kind, Kind::Read);
  EXPECT_EQ(accesses[1].kind, Kind::Write);
  uint64_t arguments[] = {0, static_cast<uint64_t>(-3)};
  for (const NamedAccess &access : accesses) {
    EXPECT_EQ(access.field, "x");
    ASSERT_EQ(access.fixed.size(), 1u);
    EXPECT_EQ(access.fixed.front().dimension, 0);
  }
  EXPECT_EQ(accesses[0].fixed.front().evaluate(arguments), -3);
  EXPECT_EQ(accesses[1].fixed.front().evaluate(arguments), -2);

  // The whole row is stored, whatever the fields contain.
  auto boxes = findStoredBoxes(*module, kernel, accesses);
  EXPECT_TRUE(boxes[0].empty());
  ASSERT_EQ(boxes[1].size(), 1u);
  const runtime::StoredBox &box = boxes[1].front();
  ASSERT_EQ(box.ranges.size(), 2u);
  EXPECT_EQ(box.ranges[0].lower.evaluate(arguments), -2);
  EXPECT_EQ(box.ranges[0].upper.evaluate(arguments), -1);
  EXPECT_EQ(box.ranges[1].lower.evaluate(arguments), 0);
  EXPECT_EQ(box.ranges[1].upper.evaluate(arguments), 16);
}

// The index of a loop with at most one iteration is the lower bound, also of a
// loop in such a loop; those of longer loops, and of loops whose length is not
// known, are no fixed indices.
TEST_F(LaunchAccessesTest, LoopsOfOneIterationAreFixedIndices) {
  parse(R"(
    tai.kernel @k(%v: f32, %t: i32, %u: i32) {
      %c1 = arith.constant 1 : index
      %c3 = arith.constant 3 : index
      %c4 = arith.constant 4 : index
      %from = arith.index_cast %t : i32 to index
      %to = arith.addi %from, %c1 : index
      %end = arith.index_cast %u : i32 to index
      tai.parallel_for (%i, %j) = (%from, %c3) to (%to, %c4) {
        %behind = arith.addi %i, %c1 : index
        scf.for %k = %i to %behind step %c1 {
          %0 = tai.load @x[%k, %j] : f32
          tai.store %0, @x[%i, %j] : f32
        }
        scf.for %k = %c3 to %c4 step %c4 {
          scf.for %l = %c1 to %c3 step %c1 {
            tai.store %v, @x[%k, %l] : f32
          }
        }
        scf.for %k = %from to %end step %c1 {
          %0 = tai.load @x[%k, %k] : f32
        }
      }
      tai.return
    })");
  std::vector<NamedAccess> accesses = listAccesses(kernel);
  ASSERT_EQ(accesses.size(), 4u);
  uint64_t arguments[] = {0, 5, 9};
  for (size_t i : {0, 1}) {
    ASSERT_EQ(accesses[i].fixed.size(), 2u);
    EXPECT_EQ(accesses[i].fixed[0].evaluate(arguments), 5);
    EXPECT_EQ(accesses[i].fixed[1].evaluate(arguments), 3);
  }
  ASSERT_EQ(accesses[2].fixed.size(), 1u);
  EXPECT_EQ(accesses[2].fixed[0].dimension, 0);
  EXPECT_EQ(accesses[2].fixed[0].evaluate(arguments), 3);
  EXPECT_TRUE(accesses[3].fixed.empty());
}

// A 32-bit sum wraps around at the launch as it does in the kernel, also after
// it was serialised.
TEST_F(LaunchAccessesTest, SumsWrapAsTheProgramDoes) {
  parse(R"(
    tai.kernel @k(%v: f32, %t: i32) {
      %c1 = arith.constant 1 : i32
      %row = arith.index_cast %t : i32 to index
      %sum = arith.addi %t, %c1 : i32
      %next = arith.index_cast %sum : i32 to index
      %c0 = arith.constant 0 : index
      %0 = tai.load @x[%row, %c0] : f32
      tai.store %0, @x[%next, %c0] : f32
      tai.return
    })");
  std::vector<NamedAccess> accesses = listAccesses(kernel);
  ASSERT_EQ(accesses.size(), 2u);
  EXPECT_TRUE(accesses[0].fixed.front().isApart(accesses[1].fixed.front()));
  ToBeRecorded record;
  record.reads = accesses;
  std::optional<ToBeRecorded> again =
      ToBeRecorded::deserialize(record.serialize());
  ASSERT_TRUE(again);
  for (const NamedAccess &access : {accesses[1], again->reads[1]}) {
    uint64_t last[] = {0, INT32_MAX};
    EXPECT_EQ(access.fixed.front().evaluate(last), INT32_MIN);
    uint64_t first[] = {0, 0};
    EXPECT_EQ(access.fixed.front().evaluate(first), 1);
  }
}

TEST_F(LaunchAccessesTest, StoresUnderABranchAreNoBox) {
  parse(R"(
    tai.kernel @k(%c: i1, %v: f32) {
      tai.parallel_for (%i, %j) in @x {
        scf.if %c {
          tai.store %v, @x[%i, %j] : f32
        }
      }
      tai.return
    })");
  std::vector<NamedAccess> accesses = listAccesses(kernel);
  ASSERT_EQ(accesses.size(), 1u);
  EXPECT_TRUE(accesses[0].fixed.empty());
  EXPECT_TRUE(findStoredBoxes(*module, kernel, accesses)[0].empty());
}

// A box checks that the loops around the store that are not among its indices
// have run, unless their bounds are constants.
TEST_F(LaunchAccessesTest, LoopsAroundABoxMayBeEmpty) {
  for (auto [lower, upper, asks] :
       {std::tuple{"%c0", "%more", true}, std::tuple{"%m", "%c16", true},
        std::tuple{"%m", "%more", true}, std::tuple{"%c0", "%c16", false},
        std::tuple{"%c16", "%c0", true}}) {
    parse(R"(
      tai.kernel @k(%v: f32, %t: i32) {
        %c0 = arith.constant 0 : index
        %c1 = arith.constant 1 : index
        %c16 = arith.constant 16 : index
        %m = arith.index_cast %t : i32 to index
        %more = arith.addi %m, %c1 : index
        scf.for %k = )" +
          std::string(lower) + " to " + upper + R"( step %c1 {
          tai.parallel_for (%i, %j) in @x {
            tai.store %v, @x[%i, %j] : f32
          }
        }
        tai.return
      })");
    std::vector<NamedAccess> accesses = listAccesses(kernel);
    ASSERT_EQ(accesses.size(), 1u);
    auto boxes = findStoredBoxes(*module, kernel, accesses);
    ASSERT_EQ(boxes.size(), 1u);
    ASSERT_EQ(boxes[0].size(), 1u);
    EXPECT_EQ(boxes[0].front().loops.size(), asks ? 1u : 0u)
        << lower << " to " << upper;
  }
}

TEST_F(LaunchAccessesTest, KernelsThatOnlyLoopOverCellsNameTheirLevels) {
  parse(R"(
    tai.kernel @k(%v: f32) {
      tai.parallel_for (%i) in @s {
        tai.store %v, @s[%i] : f32
      }
      tai.return
    }
    tai.kernel @other(%v: f32) {
      %c0 = arith.constant 0 : index
      tai.store %v, @x[%c0, %c0] : f32
      tai.parallel_for (%i) in @s {
        tai.store %v, @s[%i] : f32
      }
      tai.return
    })");
  // The second tree, and its only level with lists.
  EXPECT_EQ(findLoopLevels(kernel), (std::vector<int64_t>{1, 0}));
  EXPECT_TRUE(findLoopLevels(module->lookupSymbol<KernelOp>("other")).empty());
}

TEST_F(LaunchAccessesTest, ValuesKnowTheStoragesThatTheyComeFrom) {
  parse(R"(
    tai.kernel @k(%n: f32) {
      tai.parallel_for (%i, %j) in @x {
        %0 = tai.load @x[%i, %j] : f32
        %1 = arith.mulf %0, %n : f32
        tai.store %1, @y[%i, %j] : f32
      }
      tai.return
    })");
  ValueFlows flows(kernel, {kernel.getArgument(0)});
  ASSERT_EQ(flows.writes.size(), 1u);
  ASSERT_EQ(flows.storages.size(), 2u);
  EXPECT_EQ(flows.storages[0].field.getValue(), "x");
  EXPECT_TRUE(flows.sourcesOf(flows.writes[0].getAccessedValue()).all());
}

TEST(ToBeRecordedTest, SurvivesBeingWrittenAndRead) {
  ToBeRecorded told;
  told.reads = {{"x", Kind::Read, {{1, -2, {{3, 32, 4}}, 64}}},
                {"y", Kind::Read, {}}};
  told.loadsStored = true;
  told.stored = {{"z", Kind::Read, {}}};
  told.before = {"b"};
  told.activity = {"a", "c"};
  told.flags = {{"loop", {"one", "two"}, true}};
  told.arrays = {0, 7};
  told.reexecutes = true;
  told.parts = "module {}";
  std::string bytes = told.serialize();
  std::optional<ToBeRecorded> read = ToBeRecorded::deserialize(bytes);
  ASSERT_TRUE(read);
  EXPECT_EQ(read->reads, told.reads);
  EXPECT_EQ(read->stored, told.stored);
  EXPECT_EQ(read->flags[0].sources, told.flags[0].sources);
  EXPECT_TRUE(read->flags[0].sumsUp && read->reexecutes && read->loadsStored);
  EXPECT_EQ(read->arrays, told.arrays);
  EXPECT_EQ(read->parts, told.parts);
  EXPECT_EQ(read->serialize(), bytes);

  for (size_t length = 0; length < bytes.size(); ++length)
    EXPECT_FALSE(ToBeRecorded::deserialize(bytes.substr(0, length))) << length;
  EXPECT_FALSE(ToBeRecorded::deserialize(bytes + "x"));
}
