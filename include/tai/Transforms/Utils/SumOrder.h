//===- SumOrder.h - The order of float sums over iterations -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A sum of all iterations whose order is the same on every target. The n
// iterations, in their row-major order, are cut into chunks of 256 * (n / 8192
// + 1), so that there are 32 at the most. Lane l of a chunk adds up its
// iterations l, l + 256, ... one after another. Lanes l and l + 128 are added,
// then l and l + 64, and so on until four are left: the groups of the chunk.
// All groups of all chunks are added up one after another. Additions are in
// f64; the total is rounded once to the type of the sum.
//
// See docs/decisions/0039-bits.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_UTILS_SUMORDER_H
#define TAI_TRANSFORMS_UTILS_SUMORDER_H

#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Utils/FieldAddress.h"

namespace mlir::tai {

struct SumOrder {
  static constexpr int64_t kChunks = 32;
  static constexpr int64_t kLanes = 256;
  static constexpr int64_t kGroups = 4;
};

/// The type of the 256 partial sums (lanes) of a sum of values of `type`.
Type getLaneType(AtomicKind kind, Type type);

/// The initial value of the lanes (partial sums): adding it changes no number,
/// not even -0.
TypedAttr getLaneStart(AtomicKind kind, Type type);

/// The number of iterations in a chunk of a sum over `iterations` >= 0
/// iterations.
int64_t getChunkLength(int64_t iterations);
Value emitChunkLength(OpBuilder &builder, Location loc, Value iterations);

/// Adds up the lanes (partial sums of a chunk) in place until only the groups
/// `first`, `first` + `step` and so on are left: 0 and 1 for all groups.
/// `scopes` is for the memory accesses to lanes.
void emitLaneTree(OpBuilder &builder, Location loc, AtomicKind kind, Type type,
                  Value lanes, Value first, int64_t step,
                  const AliasScopes &scopes = {});

} // namespace mlir::tai

#endif // TAI_TRANSFORMS_UTILS_SUMORDER_H
