//===- ProgramTiles.h - Launches that share tiles ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A chain of launches over one box in which each reads what those before wrote
// at cells nearby. A block does its tile of all of them, the earlier ones with
// a halo, without waiting for other blocks: what the chain writes it keeps in
// an overlay in memory of its own, and writes its own part of that in the end.
// See docs/decisions/0012-fused-launches.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_QUEUE_PROGRAMTILES_H
#define TAI_RUNTIME_QUEUE_PROGRAMTILES_H

#include "tai/ABI/DeviceAccesses.h"
#include <cstddef>

namespace mlir::tai::runtime {

/// By how many cells something is larger than a tile, at both ends of each
/// dimension.
struct TileHalo {
  std::vector<int64_t> low, high;
  bool operator==(const TileHalo &other) const {
    return low == other.low && high == other.high;
  }
};

/// An array of cells that the chain writes, of which each block has an overlay:
/// the cells of its tile and of a halo.
struct TileRow {
  /// A launch and a site of that which lead to it.
  size_t stage = 0;
  TileSite site;
  TileHalo halo;
  /// Whether the overlay starts with what is in memory.
  bool isLoaded = false;
  /// Where its overlay is in that of all rows, in bytes.
  int64_t offset = 0;

  bool operator==(const TileRow &other) const {
    return stage == other.stage && site == other.site && halo == other.halo &&
           isLoaded == other.isLoaded && offset == other.offset;
  }
};

/// A launch of a chain.
struct TileStage {
  /// The number of the part that does an iteration of it.
  uint64_t part = 0;
  /// The first of its parameters among those of all launches of the chain.
  size_t firstSlot = 0, numSlots = 0;
  TileHalo halo;
  std::vector<TileSite> sites;
  /// For each site the number of the row; -1 for memory.
  std::vector<int> rows;

  bool operator==(const TileStage &other) const {
    return part == other.part && firstSlot == other.firstSlot &&
           numSlots == other.numSlots && halo == other.halo &&
           sites == other.sites && rows == other.rows;
  }
};

struct TileChain {
  /// The box of all launches.
  std::vector<int64_t> lower, upper;
  /// Dimensions whose borders are neighbours.
  std::vector<bool> isCyclic;
  /// The cells of a tile, and how many tiles there are, along each dimension.
  std::vector<int64_t> tile, tiles;
  std::vector<TileStage> stages;
  std::vector<TileRow> rows;
  /// The bytes of the overlay of a block.
  int64_t bytes = 0;
  /// No block may write before all have loaded.
  bool mustWait = false;

  int64_t numTiles() const {
    int64_t number = 1;
    for (int64_t along : tiles)
      number *= along;
    return number;
  }
  /// The most that a block has to do for one launch.
  int64_t mostCells() const {
    int64_t most = 0;
    for (const TileStage &stage : stages) {
      int64_t cells = 1;
      for (size_t d = 0; d < tile.size(); ++d)
        cells *= tile[d] + stage.halo.low[d] + stage.halo.high[d];
      most = cells > most ? cells : most;
    }
    return most;
  }
  bool operator==(const TileChain &other) const {
    return lower == other.lower && upper == other.upper &&
           isCyclic == other.isCyclic && tile == other.tile &&
           tiles == other.tiles && stages == other.stages &&
           rows == other.rows && bytes == other.bytes &&
           mustWait == other.mustWait;
  }
};

/// Steps of a program with this number or a higher one are chains.
constexpr uint64_t firstChainPart = uint64_t(1) << 24;

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_QUEUE_PROGRAMTILES_H
