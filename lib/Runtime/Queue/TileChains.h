//===- TileChains.h - Which launches share tiles ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_TILECHAINS_H
#define TAI_LIB_RUNTIME_QUEUE_TILECHAINS_H

#include "tai/Runtime/Queue/ProgramTiles.h"

namespace mlir::tai::runtime {

/// A launch, as far as chains are concerned.
struct ChainStep {
  /// Null for what cannot run in tiles.
  const FunctionAccesses *function = nullptr;
  const uint64_t *slots = nullptr;
  size_t numSlots = 0;
  /// The number of the part that does an iteration of it.
  uint64_t part = 0;
};

struct TileLimits {
  /// Tiles of all blocks, bytes of the overlay of one, and cells of a tile with
  /// its halo.
  int64_t mostTiles = 1, mostBytes = 0, mostCells = 0;
};

/// The chain of `count` steps; nothing if they are none.
std::optional<TileChain> makeChain(const ChainStep *steps, size_t count,
                                   const TileLimits &limits);

/// The longest chain at the start of `count` steps whose last launch has to do
/// with the others, and its length.
std::optional<std::pair<TileChain, size_t>>
findChain(const ChainStep *steps, size_t count, const TileLimits &limits);

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_TILECHAINS_H
