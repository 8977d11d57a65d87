//===- Lists.cpp - Lists of active cells on the device --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A list is computed from the bits or lengths of a level, in the order of the
// cells, by a parallel prefix sum: a block counts the cells of a tile, sums
// over the tiles before it give the position of its cells, and each thread
// finds the cells of some positions. So the result does not depend on the
// number of blocks or threads.
//
// A kernel returns at once if its list is up to date: the host queues these
// kernels without knowing the state.
//
//===----------------------------------------------------------------------===//

#include "Level.h"
#include "tai/ABI/DeviceAbi.h"

using namespace tai::device;

constexpr int64_t tileUnits = TAI_DEVICE_LIST_TILE;

static int64_t threadId() { return tai_dev_thread_id(); }
static int64_t numThreads() { return tai_dev_block_dim(); }

namespace {
/// A level and its list. A unit is a word of bits, or the length of a list.
struct ListMaker {
  Level level;
  TaiDeviceListHeader *header;
  int64_t units, tiles;

  ListMaker(uint64_t tree, uint64_t node, uint64_t list)
      : level(reinterpret_cast<char *>(tree), static_cast<int32_t>(node)),
        header(reinterpret_cast<TaiDeviceListHeader *>(list)) {
    units = level.node.isList ? level.node.cells / level.node.capacity
                              : (level.node.cells + 63) / 64;
    tiles = (units + tileUnits - 1) / tileUnits;
  }

  int64_t *cells() const { return reinterpret_cast<int64_t *>(header + 1); }
  /// Whether the list is out of date: the activity has changed since it was
  /// computed.
  bool isOld() const {
    const TaiDeviceActivity &activity = *level.node.activity;
    return activity.isNew || header->version != activity.version;
  }
  /// Marks the list as up to date. To be called by one thread, after isOld()
  /// has returned on all threads.
  void finish(int64_t count) const {
    TaiDeviceActivity &activity = *level.node.activity;
    if (activity.isNew) {
      activity.isNew = 0;
      ++activity.version;
    }
    header->version = activity.version;
    header->count = count;
  }

  bool isEmpty(int64_t tile) const {
    int64_t first = tile * (tileUnits / 64), end = first + tileUnits / 64;
    int64_t most = (units + 63) / 64;
    uint64_t any = 0;
    for (int64_t i = first; i < end && i < most; ++i)
      any |= level.node.marks[i];
    return !any;
  }
  int64_t count(int64_t unit) const {
    if (unit >= units || !(level.node.marks[unit / 64] >> (unit % 64) & 1))
      return 0;
    return level.node.isList ? level.lengths()[unit]
                             : __builtin_popcountll(level.words()[unit]);
  }
  /// The number of an active cell of `unit`: the cell that follows `before`
  /// active cells of the unit.
  int64_t cellOf(int64_t unit, int64_t before) const {
    if (level.node.isList)
      return unit * level.node.capacity + before;
    uint64_t word = level.words()[unit];
    int64_t bit = 0;
    auto rest = static_cast<int>(before);
    for (int width = 32; width > 0; width /= 2) {
      int here = __builtin_popcountll(word & ((uint64_t(1) << width) - 1));
      if (rest < here)
        continue;
      rest -= here;
      word >>= width;
      bit += width;
    }
    return unit * 64 + bit;
  }
};
} // namespace

//===----------------------------------------------------------------------===//
// Sums over a tile
//===----------------------------------------------------------------------===//

TAI_SHARED_VARIABLE static int64_t rows[2][tileUnits];

namespace {
class Sums {
public:
  /// Computes of(i) for each index i of a tile, and returns the inclusive
  /// prefix sums of these numbers, which all threads of the block can read
  /// until they call `release`.
  template <typename Of> const int64_t *make(const Of &of) {
    int64_t thread = threadId(), threads = numThreads();
#ifndef __NVPTX__
    if (threads == 1) {
      int64_t sum = 0;
      for (int64_t i = 0; i < tileUnits; ++i)
        rows[0][i] = sum += of(i);
      return rows[0];
    }
#endif
    for (int64_t i = thread; i < tileUnits; i += threads)
      rows[0][i] = of(i);
    tai_dev_block_barrier();
    int from = 0;
    for (int64_t distance = 1; distance < tileUnits; distance *= 2) {
      for (int64_t i = thread; i < tileUnits; i += threads)
        rows[1 - from][i] =
            rows[from][i] + (i < distance ? 0 : rows[from][i - distance]);
      tai_dev_block_barrier();
      from = 1 - from;
    }
    return (const int64_t *)rows[from];
  }
  void release() { tai_dev_block_barrier(); }
};
} // namespace

static const int64_t *countTile(Sums &sums, const ListMaker &maker,
                                int64_t tile) {
  return sums.make(
      [&](int64_t i) { return maker.count(tile * tileUnits + i); });
}

/// Writes the active cells of a tile to `to`. `upTo`: the prefix sums of the
/// tile.
static void writeTile(const ListMaker &maker, int64_t tile, const int64_t *upTo,
                      int64_t *to) {
  int64_t total = upTo[tileUnits - 1];
  for (int64_t at = threadId(); at < total; at += numThreads()) {
    int64_t low = 0;
    for (int64_t step = tileUnits / 2; step > 0; step /= 2)
      if (upTo[low + step - 1] <= at)
        low += step;
    int64_t before = low ? upTo[low - 1] : 0;
    to[at] = maker.cellOf(tile * tileUnits + low, at - before);
  }
}

//===----------------------------------------------------------------------===//
// Lists
//===----------------------------------------------------------------------===//

void tai_dev_list_cells(uint64_t tree, uint64_t node, uint64_t list) {
  if (tai_dev_block_id() != 0)
    return;
  ListMaker maker(tree, node, list);
  bool isOld = maker.isOld();
  tai_dev_block_barrier();
  if (!isOld)
    return;
  Sums sums;
  int64_t count = 0;
  for (int64_t tile = 0; tile < maker.tiles; ++tile) {
    if (maker.isEmpty(tile))
      continue;
    const int64_t *upTo = countTile(sums, maker, tile);
    writeTile(maker, tile, upTo, maker.cells() + count);
    count += upTo[tileUnits - 1];
    sums.release();
  }
  if (threadId() == 0)
    maker.finish(count);
}

void tai_dev_list_count(uint64_t tree, uint64_t node, uint64_t list,
                        uint64_t tileSums) {
  ListMaker maker(tree, node, list);
  if (!maker.isOld())
    return;
  auto *counts = reinterpret_cast<int64_t *>(tileSums);
  Sums sums;
  for (int64_t tile = tai_dev_block_id(); tile < maker.tiles;
       tile += tai_dev_grid_dim()) {
    int64_t count = 0;
    if (!maker.isEmpty(tile)) {
      count = countTile(sums, maker, tile)[tileUnits - 1];
      sums.release();
    }
    if (threadId() == 0)
      counts[tile] = count;
  }
}

void tai_dev_list_scan(uint64_t tree, uint64_t node, uint64_t list,
                       uint64_t tileSums) {
  if (tai_dev_block_id() != 0)
    return;
  ListMaker maker(tree, node, list);
  bool isOld = maker.isOld();
  tai_dev_block_barrier();
  if (threadId() == 0)
    maker.header->isOld = isOld;
  if (!isOld)
    return;
  auto *counts = reinterpret_cast<int64_t *>(tileSums);
  // Divide the tiles so that each thread sums over consecutive tiles.
  int64_t threads = numThreads();
  int64_t some = (maker.tiles + threads - 1) / threads;
  auto forEach = [&](int64_t thread, auto body) {
    int64_t end = (thread + 1) * some;
    for (int64_t i = thread * some; i < end && i < maker.tiles; ++i)
      body(counts[i]);
  };
  Sums sums;
  const int64_t *upTo = sums.make([&](int64_t thread) {
    int64_t sum = 0;
    if (thread < threads)
      forEach(thread, [&](int64_t &count) { sum += count; });
    return sum;
  });
  int64_t sum = threadId() ? upTo[threadId() - 1] : 0;
  forEach(threadId(), [&](int64_t &count) {
    int64_t here = count;
    count = sum;
    sum += here;
  });
  if (threadId() == 0)
    maker.finish(upTo[tileUnits - 1]);
}

void tai_dev_list_write(uint64_t tree, uint64_t node, uint64_t list,
                        uint64_t tileSums) {
  ListMaker maker(tree, node, list);
  if (!maker.header->isOld)
    return;
  auto *starts = reinterpret_cast<const int64_t *>(tileSums);
  Sums sums;
  for (int64_t tile = tai_dev_block_id(); tile < maker.tiles;
       tile += tai_dev_grid_dim()) {
    if (maker.isEmpty(tile))
      continue;
    writeTile(maker, tile, countTile(sums, maker, tile),
              maker.cells() + starts[tile]);
    sums.release();
  }
}

//===----------------------------------------------------------------------===//
// Cells of a list
//===----------------------------------------------------------------------===//

void tai_dev_deactivate_list(uint64_t tree, uint64_t node, uint64_t list) {
  ListMaker maker(tree, node, list);
  const Level &level = maker.level;
  auto number = static_cast<int32_t>(node);
  int64_t thread = threadId(), threads = numThreads();
  for (int64_t i = tai_dev_block_id(); i < maker.header->count;
       i += tai_dev_grid_dim()) {
    int64_t cell = maker.cells()[i];
    // A cell that holds only cells of other levels needs no zeroing here: its
    // contents have been zeroed before.
    if (!level.node.holdsCellsAlone)
      zero(level.addressOf(cell), level.node.cellBytes, thread, threads);
    clearBelow(level, number, cell, 1, thread, threads);
    if (thread != 0)
      continue;
    if (!level.node.isList)
      level.clear(cell, 1);
    else if (cell % level.node.capacity == 0)
      level.clear(cell, level.node.capacity);
  }
}

//===----------------------------------------------------------------------===//
// Changes of activity
//===----------------------------------------------------------------------===//

/// Copies `words` words of 32 bits and, if `forgets`, zeroes the source; this
/// thread does its share.
static void copyWords(uint32_t *to, uint32_t *from, int64_t words,
                      bool forgets) {
  for (int64_t i = threadId(); i < words; i += numThreads()) {
    to[i] = from[i];
    if (forgets)
      from[i] = 0;
  }
}

void tai_dev_keep_activity(uint64_t tree, uint64_t to) {
  if (tai_dev_block_id() != 0)
    return;
  auto *base = reinterpret_cast<char *>(tree);
  auto *changes = reinterpret_cast<uint64_t *>(to);
  auto levels = static_cast<int32_t>(Level(base, 0).tree.numNodes);
  uint64_t *at = changes + levels;
  for (int32_t i = 0; i < levels; ++i) {
    Level level(base, i);
    const TaiDeviceNode &node = level.node;
    // The number of 32-bit words of the level's activity: a length is one word,
    // a 64-bit word of bits two.
    int64_t words =
        node.isList ? node.cells / node.capacity : (node.cells + 63) / 64 * 2;
    int64_t room = (words + 1) / 2;
    uint32_t happened = node.activity->changes;
    if (happened)
      copyWords(reinterpret_cast<uint32_t *>(at),
                reinterpret_cast<uint32_t *>(level.lengths()), words,
                /*forgets=*/false);
    at += room;
    if (happened & TAI_DEVICE_CELLS_REMOVED)
      copyWords(reinterpret_cast<uint32_t *>(at),
                static_cast<uint32_t *>(node.removed), words, /*forgets=*/true);
    at += room;
  }
  tai_dev_block_barrier();
  if (threadId() != 0)
    return;
  for (int32_t i = 0; i < levels; ++i) {
    TaiDeviceActivity &activity = *Level(base, i).node.activity;
    changes[i] = activity.changes;
    activity.changes = 0;
  }
}
