//===- LaneSums.h - Sums in the order of all targets ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A sum over iterations in chunks and lanes (tai/Transforms/Utils/SumOrder.h).
// The lanes of a chunk are an array on the stack that neighbouring iterations
// add to, which LLVM vectorises without reordering.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOHOST_LANESUMS_H
#define TAI_LIB_CONVERSION_TAITOHOST_LANESUMS_H

#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

class LaneSum {
public:
  /// `type`: of the terms.
  LaneSum(AtomicKind kind, Type type);
  /// The type of the lanes and of their sum.
  Type getType() const { return type; }

  /// In the kernel, before the loop: room for the groups of all chunks.
  void emitGroups(OpBuilder &builder, Location loc);
  /// In the function of the loop, at its entry: room for lanes.
  void emitLanes(OpBuilder &builder, Location loc);
  /// Around the iterations of a chunk.
  void emitChunkStart(OpBuilder &builder, Location loc);
  void emitChunkEnd(OpBuilder &builder, Location loc, Value chunk);
  /// At an update, which adds or subtracts, say.
  void emitTerm(OpBuilder &builder, Location loc, AtomicKind update, Value term,
                Value lane);
  /// In the kernel, behind the loop.
  Value emitTotal(OpBuilder &builder, Location loc, Value chunks);

private:
  Value emitAddress(OpBuilder &builder, Location loc, Value base, Value index);

  AtomicKind kind;
  Type type;
  Value groups, lanes;
};

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOHOST_LANESUMS_H
