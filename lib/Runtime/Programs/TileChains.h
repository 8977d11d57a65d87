//===- TileChains.h - Finds launches that share tiles -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_PROGRAMS_TILECHAINS_H
#define TAI_LIB_RUNTIME_PROGRAMS_TILECHAINS_H

#include "tai/Runtime/Programs/ProgramTiles.h"

namespace mlir::tai::runtime {

/// Describes a launch, as input to the search for tile chains.
struct ChainStep {
  /// The accesses of the launched function; null if it cannot run in tiles.
  const FunctionAccesses *function = nullptr;
  const uint64_t *slots = nullptr;
  size_t numSlots = 0;
  /// The number of the program's part that runs one iteration of the function.
  uint64_t part = 0;
};

struct TileLimits {
  /// Maxima for a tile chain: the number of tiles, bytes of shared memory in a
  /// block, and cells of a tile with its halo.
  int64_t mostTiles = 1, mostBytes = 0, mostCells = 0;
};

/// Makes a tile chain of all `count` steps; no value if they do not form one.
std::optional<TileChain> makeChain(const ChainStep *steps, size_t count,
                                   const TileLimits &limits);

/// Finds the longest tile chain at the start of `count` steps whose last launch
/// shares data with the others; returns it and its length.
std::optional<std::pair<TileChain, size_t>>
findChain(const ChainStep *steps, size_t count, const TileLimits &limits);

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_PROGRAMS_TILECHAINS_H
