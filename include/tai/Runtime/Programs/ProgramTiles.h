//===- ProgramTiles.h - Launches fused by tiles -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A tile chain: launches over one box in which each launch reads results of
// earlier launches at nearby cells (stencils). A block computes one tile of all
// launches (of earlier ones with a halo) without waiting for other blocks: it
// keeps written cells in an overlay in shared memory, and stores its own tile
// at the end (overlapped tiling). See docs/decisions/0012-fused-launches.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_PROGRAMS_PROGRAMTILES_H
#define TAI_RUNTIME_PROGRAMS_PROGRAMTILES_H

#include "tai/ABI/DeviceAccesses.h"
#include <cstddef>

namespace mlir::tai::runtime {

/// The width of a halo in cells, at both ends of each dimension.
struct TileHalo {
  std::vector<int64_t> low, high;
  bool operator==(const TileHalo &other) const {
    return low == other.low && high == other.high;
  }
};

/// An array that launches of a tile chain write. Each thread block has an
/// overlay of the array in shared memory: a copy of the cells of its tile and
/// of a halo.
struct TileRow {
  /// One launch of the chain (an index into TileChain::stages), and a site in
  /// it that accesses the array.
  size_t stage = 0;
  TileSite site;
  TileHalo halo;
  /// True if a thread block first loads the overlay from the array.
  bool isLoaded = false;
  /// The offset of the array's overlay in the shared memory of a thread block,
  /// in bytes.
  int64_t offset = 0;

  bool operator==(const TileRow &other) const {
    return stage == other.stage && site == other.site && halo == other.halo &&
           isLoaded == other.isLoaded && offset == other.offset;
  }
};

/// A launch of a tile chain.
struct TileStage {
  /// The number of the program part that runs one iteration of the launch.
  uint64_t part = 0;
  /// The range of the launch's parameters among the parameters of all launches
  /// of the chain.
  size_t firstSlot = 0, numSlots = 0;
  TileHalo halo;
  std::vector<TileSite> sites;
  /// For each load or store site of the launch, the index in TileChain::rows of
  /// the array that it accesses; -1 if the site accesses global memory without
  /// an overlay.
  std::vector<int> rows;

  bool operator==(const TileStage &other) const {
    return part == other.part && firstSlot == other.firstSlot &&
           numSlots == other.numSlots && halo == other.halo &&
           sites == other.sites && rows == other.rows;
  }
};

struct TileChain {
  /// The box of iterations that all launches of the tile chain cover.
  std::vector<int64_t> lower, upper;
  /// For each dimension, true if it has periodic boundaries.
  std::vector<bool> isCyclic;
  /// Along each dimension: the size of a tile in cells, and the number of
  /// tiles.
  std::vector<int64_t> tile, tiles;
  std::vector<TileStage> stages;
  std::vector<TileRow> rows;
  /// The bytes of shared memory that a thread block needs for the overlays of
  /// all arrays.
  int64_t bytes = 0;
  /// True if all thread blocks must have loaded their overlays before any block
  /// stores its tile: a grid barrier separates loads from stores.
  bool mustWait = false;

  int64_t numTiles() const {
    int64_t number = 1;
    for (int64_t along : tiles)
      number *= along;
    return number;
  }
  /// The largest number of cells that a thread block computes for any one
  /// launch.
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

/// Part numbers of a program from this number on stand for tile chains.
constexpr uint64_t firstChainPart = uint64_t(1) << 24;

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_PROGRAMS_PROGRAMTILES_H
