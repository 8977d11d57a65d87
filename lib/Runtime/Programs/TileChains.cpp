//===- TileChains.cpp - Finds launches that share tiles -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Everything is decided from the sites of the launches, with the addresses that
// their parameters give. Each array that the chain writes is called a row; all
// accesses of the chain to memory of the array must be sites of this row.
//
//===----------------------------------------------------------------------===//

#include "TileChains.h"
#include "tai/Runtime/Programs/ProgramSchedule.h"
#include <algorithm>
#include <cmath>
#include <numeric>

using namespace mlir::tai::runtime;

namespace {
/// A load or store site of a launch, with its address and range in memory.
struct Place {
  const TileSite *site;
  uint64_t address, begin, end;
  /// All distances between elements, in bytes, are multiples of `step`.
  int64_t step;
};

class ChainMaker {
public:
  ChainMaker(const ChainStep *steps, size_t count, const TileLimits &limits)
      : steps(steps), count(count), limits(limits) {}
  std::optional<TileChain> make();

private:
  bool addStages();
  bool findPlace(const ChainStep &step, const TileSite &site,
                 Place &place) const;
  bool findRows();
  bool isApart(const Place &one, const Place &other) const;
  bool findCyclicDimensions();
  bool findRaces() const;
  void findHalos();
  void findLoads();
  void alignHalos();
  bool chooseTile();
  /// Calls f(stage, site, array) for each load or store site that accesses an
  /// array which the chain of launches writes.
  template <typename F> void forEachSite(const F &f) {
    for (size_t s = 0; s < count; ++s)
      for (size_t k = 0; k < chain.stages[s].sites.size(); ++k)
        if (int row = chain.stages[s].rows[k]; row >= 0)
          f(s, chain.stages[s].sites[k], chain.rows[static_cast<size_t>(row)]);
  }

  const ChainStep *steps;
  size_t count;
  TileLimits limits;
  TileChain chain;
  size_t rank = 0;
  std::vector<std::vector<Place>> places;
  /// For each array that the chain of launches writes, the memory of all its
  /// cells.
  std::vector<Place> rowPlaces;
};
} // namespace

static bool isWrite(const TileSite &site) {
  return site.access.kind != DeviceAccess::Read;
}

/// Adds a stage to the tile chain for each launch. False unless all launches
/// run over one box of iterations.
bool ChainMaker::addStages() {
  if (count == 0 || !steps[0].function)
    return false;
  const FunctionAccesses &first = *steps[0].function;
  rank = first.extents.size();
  if (rank == 0 || rank > 3)
    return false;
  chain.lower = first.lower;
  for (size_t d = 0; d < rank; ++d) {
    if (first.extents[d] < 1)
      return false;
    chain.upper.push_back(first.lower[d] + first.extents[d]);
  }
  size_t slots = 0;
  for (size_t s = 0; s < count; ++s) {
    const FunctionAccesses *function = steps[s].function;
    if (!function || function->sites.empty() ||
        function->lower != first.lower || function->extents != first.extents)
      return false;
    TileStage stage;
    stage.part = steps[s].part;
    stage.firstSlot = slots;
    stage.numSlots = steps[s].numSlots;
    stage.sites = function->sites;
    stage.rows.assign(stage.sites.size(), -1);
    stage.halo.low.assign(rank, 0);
    stage.halo.high.assign(rank, 0);
    slots += steps[s].numSlots;
    chain.stages.push_back(std::move(stage));
  }
  return true;
}

bool ChainMaker::findPlace(const ChainStep &step, const TileSite &site,
                           Place &place) const {
  const DeviceAccess &access = site.access;
  auto has = [&](int64_t slot) {
    return slot >= 0 && static_cast<size_t>(slot) < step.numSlots;
  };
  if (!has(access.slot))
    return false;
  place.site = &site;
  place.address =
      step.slots[access.slot] + static_cast<uint64_t>(access.offset);
  double sum = std::abs(double(access.offset)) + double(access.window);
  for (const LaunchTerm &term : access.terms) {
    if (!has(term.slot) || term.bits < 1 || term.bits > 64)
      return false;
    int64_t value = term.getArgument(step.slots);
    place.address +=
        static_cast<uint64_t>(value) * static_cast<uint64_t>(term.factor);
    sum += std::abs(double(value) * double(term.factor));
  }
  int64_t low = 0, high = access.window;
  place.step = access.step;
  for (size_t d = 0; d < rank; ++d) {
    int64_t first = 0, last = chain.upper[d] - chain.lower[d] - 1,
            stride = access.strides[d];
    if (site.isRegular) {
      const TileSite::Digit &digit = site.digits[d];
      stride = digit.stride;
      if (stride < 0 || digit.extent < 0)
        return false;
      first = digit.wraps ? 0 : chain.lower[d] + digit.shift;
      last = digit.wraps ? digit.extent - 1 : chain.upper[d] - 1 + digit.shift;
      place.step = std::gcd(place.step, stride);
    }
    low += std::min(first * stride, last * stride);
    high += std::max(first * stride, last * stride);
    sum += std::abs(double(stride)) *
           std::max(std::abs(double(first)), std::abs(double(last)));
  }
  place.begin = place.address + static_cast<uint64_t>(low);
  place.end = place.address + static_cast<uint64_t>(high);
  return access.unit == 0 || sum < 0x1p30 * double(access.unit);
}

/// True only if the memory of the two sites has no byte in common.
bool ChainMaker::isApart(const Place &one, const Place &other) const {
  if (one.end <= other.begin || other.end <= one.begin)
    return true;
  return liesBetween(static_cast<int64_t>(other.address - one.address),
                     other.site->access.size, one.site->access.size,
                     std::gcd(one.step, other.step));
}

static bool areSameCells(const TileSite &one, const TileSite &other) {
  if (one.access.size != other.access.size)
    return false;
  for (size_t d = 0; d < one.digits.size(); ++d)
    if (one.digits[d].stride != other.digits[d].stride ||
        one.digits[d].extent != other.digits[d].extent)
      return false;
  return true;
}

/// True if no two cells that a load or store site accesses share a byte.
static bool isInjective(const TileSite &site) {
  std::vector<TileSite::Digit> digits = site.digits;
  std::sort(digits.begin(), digits.end(),
            [](const TileSite::Digit &a, const TileSite::Digit &b) {
              return a.stride < b.stride;
            });
  int64_t bytes = site.access.size;
  for (const TileSite::Digit &digit : digits) {
    if (digit.stride < bytes || digit.extent < 1)
      return false;
    bytes = digit.stride * (digit.extent - 1) + bytes;
  }
  return true;
}

bool ChainMaker::findRows() {
  places.resize(count);
  for (size_t s = 0; s < count; ++s)
    for (const TileSite &site : chain.stages[s].sites) {
      Place place;
      if (!findPlace(steps[s], site, place))
        return false;
      places[s].push_back(place);
      if (!isWrite(site))
        continue;
      // Each iteration must write only the cell of the array that has its own
      // number.
      bool isOwn = site.isRegular && isInjective(site);
      for (size_t d = 0; isOwn && d < rank; ++d)
        isOwn = site.digits[d].shift == 0 && !site.digits[d].wraps &&
                chain.lower[d] >= 0 && chain.upper[d] <= site.digits[d].extent;
      if (!isOwn)
        return false;
      bool isKnown = std::any_of(rowPlaces.begin(), rowPlaces.end(),
                                 [&](const Place &row) {
                                   return row.address == place.address &&
                                          areSameCells(*row.site, site);
                                 });
      if (isKnown)
        continue;
      TileRow row;
      row.stage = s;
      row.site = site;
      row.halo.low.assign(rank, 0);
      row.halo.high.assign(rank, 0);
      chain.rows.push_back(std::move(row));
      Place all = place;
      all.begin = all.end = all.address;
      all.end += static_cast<uint64_t>(site.access.size);
      for (const TileSite::Digit &digit : site.digits)
        all.end += static_cast<uint64_t>(digit.stride * (digit.extent - 1));
      rowPlaces.push_back(all);
    }
  for (size_t s = 0; s < count; ++s)
    for (size_t k = 0; k < places[s].size(); ++k) {
      const Place &place = places[s][k];
      for (size_t r = 0; r < rowPlaces.size(); ++r) {
        bool isSame = place.site->isRegular &&
                      place.address == rowPlaces[r].address &&
                      areSameCells(*place.site, *rowPlaces[r].site);
        if (isSame)
          chain.stages[s].rows[k] = static_cast<int>(r);
        else if (!isApart(place, rowPlaces[r]))
          return false;
      }
    }
  return true;
}

bool ChainMaker::findCyclicDimensions() {
  chain.isCyclic.assign(rank, false);
  forEachSite([&](size_t, const TileSite &site, const TileRow &) {
    for (size_t d = 0; d < rank; ++d)
      if (site.digits[d].wraps)
        chain.isCyclic[d] = true;
  });
  for (const TileRow &row : chain.rows)
    for (size_t d = 0; d < rank; ++d)
      if (chain.isCyclic[d] &&
          (chain.lower[d] != 0 || chain.upper[d] != row.site.digits[d].extent))
        return false;
  return true;
}

/// Finds out whether an iteration accesses cells that other iterations of the
/// same launch write.
bool ChainMaker::findRaces() const {
  for (const TileStage &stage : chain.stages)
    for (size_t k = 0; k < stage.sites.size(); ++k)
      for (size_t w = 0; w < stage.sites.size(); ++w) {
        if (stage.rows[k] < 0 || stage.rows[k] != stage.rows[w] ||
            !isWrite(stage.sites[w]))
          continue;
        for (const TileSite::Digit &digit : stage.sites[k].digits)
          if (digit.shift != 0)
            return true;
      }
  return false;
}

static void grow(TileHalo &halo, const TileHalo &other, const TileSite &site) {
  for (size_t d = 0; d < halo.low.size(); ++d) {
    halo.low[d] = std::max(halo.low[d], other.low[d] - site.digits[d].shift);
    halo.high[d] = std::max(halo.high[d], other.high[d] + site.digits[d].shift);
  }
}

/// Finds the halo of the tile for each launch of the chain: a launch must write
/// all cells that later launches of the chain read in the tile.
void ChainMaker::findHalos() {
  for (size_t s = count; s-- > 0;) {
    TileStage &stage = chain.stages[s];
    for (size_t later = s + 1; later < count; ++later) {
      const TileStage &reader = chain.stages[later];
      for (size_t k = 0; k < reader.sites.size(); ++k)
        for (size_t w = 0; w < stage.sites.size(); ++w)
          if (reader.rows[k] >= 0 && reader.rows[k] == stage.rows[w] &&
              !isWrite(reader.sites[k]) && isWrite(stage.sites[w]))
            grow(stage.halo, reader.halo, reader.sites[k]);
    }
  }
  forEachSite([&](size_t s, const TileSite &site, TileRow &row) {
    grow(row.halo, chain.stages[s].halo, site);
  });
}

/// Finds the overlays (copies of arrays in shared memory) that start with the
/// contents of memory, and whether blocks must then wait for each other.
void ChainMaker::findLoads() {
  std::vector<bool> isWritten(chain.rows.size(), false);
  for (const TileStage &stage : chain.stages) {
    for (size_t k = 0; k < stage.sites.size(); ++k) {
      if (stage.rows[k] < 0)
        continue;
      auto r = static_cast<size_t>(stage.rows[k]);
      const TileSite &site = stage.sites[k];
      TileRow &row = chain.rows[r];
      bool keepsOld = isWrite(site) ? !site.isCertain : !isWritten[r];
      bool seesBorder = false;
      for (size_t d = 0; d < rank; ++d)
        seesBorder |= site.digits[d].shift != 0 && !chain.isCyclic[d];
      row.isLoaded |= keepsOld || seesBorder;
      // Blocks load halo cells that other blocks write at the end, so they must
      // wait. Border cells that no launch writes need no wait.
      if (keepsOld)
        for (size_t d = 0; d < rank; ++d)
          chain.mustWait |= row.halo.low[d] != 0 || row.halo.high[d] != 0;
    }
    for (size_t k = 0; k < stage.sites.size(); ++k)
      if (stage.rows[k] >= 0 && isWrite(stage.sites[k]) &&
          stage.sites[k].isCertain)
        isWritten[static_cast<size_t>(stage.rows[k])] = true;
  }
}

/// Gives all overlays the same cells, so that each cell belongs to one thread
/// and has the same place in all overlays.
void ChainMaker::alignHalos() {
  TileHalo all = chain.stages.front().halo;
  auto extend = [&](const TileHalo &other) {
    for (size_t d = 0; d < rank; ++d) {
      all.low[d] = std::max(all.low[d], other.low[d]);
      all.high[d] = std::max(all.high[d], other.high[d]);
    }
  };
  for (const TileStage &stage : chain.stages)
    extend(stage.halo);
  for (const TileRow &row : chain.rows)
    extend(row.halo);
  for (TileRow &row : chain.rows)
    row.halo = all;
}

static int64_t ceilOf(int64_t a, int64_t b) { return (a + b - 1) / b; }

/// Chooses the tile size with the fewest cells including the largest halo, such
/// that there is a block for each tile.
bool ChainMaker::chooseTile() {
  if (chain.rows.empty())
    return false;
  const TileHalo &most = chain.rows.front().halo;
  double best = 0;
  auto consider = [&](const std::vector<int64_t> &tile) {
    double cells = 1, tiles = 1;
    for (size_t d = 0; d < rank; ++d) {
      cells *= double(tile[d] + most.low[d] + most.high[d]);
      tiles *= double(ceilOf(chain.upper[d] - chain.lower[d], tile[d]));
    }
    if (tiles > double(limits.mostTiles) || cells > double(limits.mostCells) ||
        (!chain.tile.empty() && cells >= best))
      return;
    best = cells;
    chain.tile = tile;
  };
  std::vector<int64_t> tile(rank, 1);
  // Each number of tiles is tried along all dimensions but the last, which gets
  // the remaining tiles.
  auto choose = [&](auto &self, size_t d, int64_t left) -> void {
    int64_t extent = chain.upper[d] - chain.lower[d];
    if (d + 1 == rank) {
      tile[d] = ceilOf(extent, std::min(left, extent));
      consider(tile);
      return;
    }
    for (int64_t tiles = 1; tiles <= std::min(left, extent); ++tiles) {
      tile[d] = ceilOf(extent, tiles);
      self(self, d + 1, left / tiles);
    }
  };
  choose(choose, 0, limits.mostTiles);
  if (chain.tile.empty())
    return false;
  for (size_t d = 0; d < rank; ++d)
    chain.tiles.push_back(
        ceilOf(chain.upper[d] - chain.lower[d], chain.tile[d]));
  for (TileRow &row : chain.rows) {
    int64_t bytes = row.site.access.size;
    for (size_t d = 0; d < rank; ++d)
      bytes *= chain.tile[d] + row.halo.low[d] + row.halo.high[d];
    row.offset = chain.bytes;
    chain.bytes += (bytes + 15) / 16 * 16;
  }
  return chain.bytes <= limits.mostBytes;
}

std::optional<TileChain> ChainMaker::make() {
  if (!addStages() || !findRows() || !findCyclicDimensions() || findRaces())
    return std::nullopt;
  findHalos();
  findLoads();
  alignHalos();
  if (!chooseTile())
    return std::nullopt;
  return std::move(chain);
}

std::optional<TileChain>
mlir::tai::runtime::makeChain(const ChainStep *steps, size_t count,
                              const TileLimits &limits) {
  return ChainMaker(steps, count, limits).make();
}

/// True if the last launch of the chain accesses cells that earlier launches
/// write.
static bool isLastRelated(const TileChain &chain) {
  const TileStage &last = chain.stages.back();
  for (size_t s = 0; s + 1 < chain.stages.size(); ++s)
    for (size_t w = 0; w < chain.stages[s].sites.size(); ++w)
      if (chain.stages[s].rows[w] >= 0 && isWrite(chain.stages[s].sites[w]) &&
          std::count(last.rows.begin(), last.rows.end(),
                     chain.stages[s].rows[w]) > 0)
        return true;
  return false;
}

std::optional<std::pair<TileChain, size_t>>
mlir::tai::runtime::findChain(const ChainStep *steps, size_t count,
                              const TileLimits &limits) {
  constexpr size_t longest = 16;
  std::optional<std::pair<TileChain, size_t>> best;
  for (size_t length = 1; length <= std::min(count, longest); ++length) {
    std::optional<TileChain> chain = makeChain(steps, length, limits);
    if (!chain)
      break;
    if (length > 1 && isLastRelated(*chain))
      best = std::pair(std::move(*chain), length);
  }
  return best;
}
