//===- TileChainsTest.cpp - Launches that share tiles ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Launches over 10 x 8 floats, 320 bytes for each row of the tape. A function
// has three parameters: the address of a field, and the rows that it reads and
// writes.
//
//===----------------------------------------------------------------------===//

#include "../../../../lib/Runtime/Programs/TileChains.h"
#include "gtest/gtest.h"
#include <deque>

using namespace mlir::tai::runtime;

namespace {
constexpr auto reads = DeviceAccess::Read;
constexpr auto writes = DeviceAccess::Write;

/// An access to the iteration's cell, shifted, in the row that parameter `slot`
/// names.
TileSite at(DeviceAccess::Kind kind, int64_t slot, int64_t i = 0, int64_t j = 0,
            bool wraps = true) {
  TileSite site;
  site.access.kind = kind;
  site.access.size = site.access.window = 4;
  site.access.strides = {0, 0};
  site.access.terms = {{slot, 32, 320}};
  site.isRegular = site.isCertain = true;
  site.digits = {{32, 10, i, wraps && i != 0}, {4, 8, j, wraps && j != 0}};
  return site;
}

/// An access to unknown cells of the row.
TileSite anyOf(int64_t slot) {
  TileSite site = at(reads, slot);
  site.isRegular = false;
  site.access.window = 320;
  site.access.step = 4;
  site.digits.assign(2, {});
  return site;
}

TileSite sometimes(TileSite site) {
  site.isCertain = false;
  return site;
}

FunctionAccesses function(std::vector<TileSite> sites,
                          std::vector<int64_t> extents = {10, 8},
                          std::vector<int64_t> lower = {0, 0}) {
  FunctionAccesses accesses;
  accesses.isGridStride = true;
  accesses.extents = std::move(extents);
  accesses.lower = std::move(lower);
  accesses.sites = std::move(sites);
  return accesses;
}

class TileChains : public ::testing::Test {
protected:
  void add(const FunctionAccesses &accesses, uint64_t from, uint64_t to,
           uint64_t field = 4096) {
    functions.push_back(accesses);
    slots.push_back({field, from, to});
    steps.push_back({&functions.back(), slots.back().data(), 3,
                     static_cast<uint64_t>(100 + steps.size())});
  }
  std::optional<TileChain> make() {
    return makeChain(steps.data(), steps.size(), limits);
  }

  std::deque<FunctionAccesses> functions;
  std::deque<std::vector<uint64_t>> slots;
  std::vector<ChainStep> steps;
  TileLimits limits{4, 1 << 14, 1 << 10};

  FunctionAccesses sweep = function(
      {at(reads, 1, 1), at(reads, 1, -1), at(reads, 1, 0, 2), at(writes, 2)});
  /// The kernel adds to the elements.
  FunctionAccesses gather = function(
      {at(reads, 1, 1), at(reads, 1, 0, -1), at(reads, 2), at(writes, 2)});
};
} // namespace

TEST_F(TileChains, EarlierLaunchesHaveWiderHalos) {
  for (uint64_t row : {0, 1, 2})
    add(sweep, row, row + 1);
  std::optional<TileChain> chain = make();
  ASSERT_TRUE(chain);
  EXPECT_EQ(chain->stages[0].halo, (TileHalo{{2, 0}, {2, 4}}));
  EXPECT_EQ(chain->stages[1].halo, (TileHalo{{1, 0}, {1, 2}}));
  EXPECT_EQ(chain->stages[2].halo, (TileHalo{{0, 0}, {0, 0}}));
  // The first row is not written, and is not copied to the overlay.
  ASSERT_EQ(chain->rows.size(), 3u);
  EXPECT_EQ(chain->stages[0].rows, (std::vector<int>{-1, -1, -1, 0}));
  EXPECT_EQ(chain->stages[2].rows, (std::vector<int>{1, 1, 1, 2}));
  for (const TileRow &row : chain->rows)
    EXPECT_EQ(row.halo, chain->stages[0].halo);
  EXPECT_FALSE(chain->rows[0].isLoaded);
  EXPECT_FALSE(chain->mustWait);
  EXPECT_TRUE(chain->isCyclic[0] && chain->isCyclic[1]);
  EXPECT_EQ(chain->stages[1].firstSlot, 3u);
  // The chosen tiling has the fewest cells of all tilings with four tiles.
  EXPECT_EQ(chain->numTiles(), 4);
  EXPECT_EQ(chain->tile, (std::vector<int64_t>{5, 4}));
  EXPECT_EQ(chain->mostCells(), 9 * 8);
  EXPECT_EQ(chain->bytes, 3 * 4 * 9 * 8);
}

TEST_F(TileChains, WhatIsAddedToIsLoadedFirst) {
  for (uint64_t row : {0, 1, 2})
    add(gather, row, row + 1);
  std::optional<TileChain> chain = make();
  ASSERT_TRUE(chain);
  EXPECT_TRUE(chain->mustWait);
  for (const TileRow &row : chain->rows) {
    EXPECT_TRUE(row.isLoaded);
    EXPECT_EQ(row.halo, (TileHalo{{0, 2}, {2, 0}}));
  }
}

TEST_F(TileChains, BlocksDoNotWaitForWhatIsTheirOwn) {
  FunctionAccesses own =
      function({at(reads, 1), at(reads, 2), at(writes, 2), at(writes, 1)});
  add(own, 0, 1);
  add(own, 0, 1);
  std::optional<TileChain> chain = make();
  ASSERT_TRUE(chain);
  EXPECT_TRUE(chain->rows[0].isLoaded);
  EXPECT_FALSE(chain->mustWait);
}

TEST_F(TileChains, BordersAreLoaded) {
  FunctionAccesses inside = function(
      {at(reads, 1, 1, 0, false), at(reads, 1, -1, 0, false), at(writes, 2)},
      {8, 8}, {1, 0});
  add(inside, 0, 1);
  add(inside, 1, 2);
  std::optional<TileChain> chain = make();
  ASSERT_TRUE(chain);
  EXPECT_FALSE(chain->isCyclic[0]);
  EXPECT_TRUE(chain->rows[0].isLoaded);
  EXPECT_FALSE(chain->rows[1].isLoaded);
  EXPECT_FALSE(chain->mustWait);
}

TEST_F(TileChains, StoresThatMayBeLeftOutKeepTheOld) {
  FunctionAccesses some = function({at(reads, 1, 1), sometimes(at(writes, 2))});
  add(some, 0, 1);
  add(some, 1, 2);
  std::optional<TileChain> chain = make();
  ASSERT_TRUE(chain);
  EXPECT_TRUE(chain->rows[0].isLoaded && chain->rows[1].isLoaded);
  EXPECT_TRUE(chain->mustWait);
}

TEST_F(TileChains, TheLoadedIsKeptFromWritersWhoeverReadsFirst) {
  // Row 1 is read at the neighbours of each cell before it is written.
  add(sweep, 1, 2);
  add(sweep, 2, 1);
  std::optional<TileChain> chain = make();
  ASSERT_TRUE(chain);
  EXPECT_EQ(chain->rows[0].isLoaded, false);
  EXPECT_EQ(chain->rows[1].isLoaded, true);
  EXPECT_TRUE(chain->mustWait);
}

TEST_F(TileChains, WhatIsReadFromAnywhereIsNotWritten) {
  FunctionAccesses jump = function({anyOf(1), at(writes, 2)});
  add(sweep, 0, 1);
  add(jump, 5, 6);
  EXPECT_TRUE(make());
  slots.back()[1] = 1;
  EXPECT_FALSE(make());
}

TEST_F(TileChains, RowsThatOverlapAreNoRows) {
  add(sweep, 0, 1);
  add(sweep, 1, 2);
  EXPECT_TRUE(make());
  // A field that starts in the middle of another field.
  slots.back()[0] = 4096 + 32;
  EXPECT_FALSE(make());
}

TEST_F(TileChains, FieldsThatShareCellsAreApart) {
  auto first = at(writes, 2), second = at(writes, 2);
  for (TileSite *site : {&first, &second}) {
    site->digits = {{64, 10, 0, false}, {8, 8, 0, false}};
    site->access.terms = {{2, 32, 640}};
  }
  second.access.offset = 4;
  add(function({at(reads, 1, 1), first, second}), 0, 10);
  ASSERT_TRUE(make());
  EXPECT_EQ(make()->rows.size(), 2u);
  functions.back().sites[2].access.offset = 2;
  EXPECT_FALSE(make());
}

TEST_F(TileChains, EachIterationWritesItsOwnCell) {
  add(function({at(reads, 1), at(writes, 2, 1)}), 0, 1);
  EXPECT_FALSE(make());
  // All iterations along a dimension write the same cell.
  functions.back().sites[1] = at(writes, 2);
  functions.back().sites[1].digits[0] = {};
  EXPECT_FALSE(make());
  functions.back().sites[1] = at(writes, 2);
  EXPECT_TRUE(make());
}

TEST_F(TileChains, NoLaunchReadsWhatItWrites) {
  add(sweep, 0, 1);
  add(sweep, 1, 1);
  EXPECT_FALSE(make());
}

TEST_F(TileChains, AllRunOverOneBox) {
  add(sweep, 0, 1);
  FunctionAccesses smaller = sweep;
  smaller.extents = {10, 7};
  add(smaller, 1, 2);
  EXPECT_FALSE(make());
  // Indices that wrap within a part of an array are not supported either.
  functions.front().extents = {10, 7};
  EXPECT_FALSE(make());
}

TEST_F(TileChains, OverlaysHaveLimits) {
  add(sweep, 0, 1);
  add(sweep, 1, 2);
  ASSERT_TRUE(make());
  limits.mostBytes = make()->bytes - 1;
  EXPECT_FALSE(make());
  limits.mostBytes += 1;
  EXPECT_TRUE(make());
  limits.mostCells = 20;
  EXPECT_FALSE(make());
  limits.mostTiles = 80;
  EXPECT_TRUE(make());
}

TEST_F(TileChains, EndWithALaunchThatHasToDoWithOthers) {
  FunctionAccesses own = function({at(reads, 1), at(writes, 2)});
  add(sweep, 0, 1);
  add(own, 7, 8);
  add(sweep, 1, 2);
  add(own, 9, 11);
  steps.push_back({});
  auto found = findChain(steps.data(), steps.size(), limits);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->second, 3u);
  EXPECT_EQ(found->first.stages.size(), 3u);
  EXPECT_FALSE(findChain(steps.data() + 3, 2, limits));
  EXPECT_FALSE(findChain(steps.data() + 4, 1, limits));
}

TEST_F(TileChains, SitesAreEncoded) {
  FunctionAccesses accesses = sweep;
  accesses.accesses = {sweep.sites.front().access};
  accesses.lower = {-3, 5};
  auto decoded = FunctionAccesses::decode(accesses.encode());
  ASSERT_TRUE(decoded);
  EXPECT_TRUE(decoded->accesses == accesses.accesses);
  EXPECT_TRUE(decoded->sites == accesses.sites);
  EXPECT_EQ(decoded->lower, accesses.lower);
  std::vector<int64_t> words = accesses.encode();
  words.pop_back();
  EXPECT_FALSE(FunctionAccesses::decode(words));
}
