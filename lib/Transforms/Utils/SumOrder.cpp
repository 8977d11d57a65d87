//===- SumOrder.cpp - The order of float sums over iterations -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Transforms/Utils/SumOrder.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"
#include "tai/Transforms/Utils/IndexMath.h"

using namespace mlir;
using namespace mlir::tai;

/// The number of iterations in one round, in which each lane (partial sum) of
/// each chunk gets one more term.
constexpr int64_t kRound = SumOrder::kChunks * SumOrder::kLanes;

Type tai::getLaneType(AtomicKind kind, Type type) {
  bool isWidened = isa<FloatType>(type) && type.getIntOrFloatBitWidth() < 64 &&
                   kind == AtomicKind::Add;
  return isWidened ? Float64Type::get(type.getContext()) : type;
}

TypedAttr tai::getLaneStart(AtomicKind kind, Type type) {
  if (isa<FloatType>(type) && kind == AtomicKind::Add)
    return Builder(type.getContext()).getFloatAttr(type, -0.0);
  return getIdentity(kind, type);
}

int64_t tai::getChunkLength(int64_t iterations) {
  return (iterations / kRound + 1) * SumOrder::kLanes;
}

Value tai::emitChunkLength(OpBuilder &builder, Location loc, Value iterations) {
  IndexMath math(builder, loc);
  Value rounds = math.add(math.div(iterations, kRound), math.constant(1));
  return math.mul(rounds, SumOrder::kLanes);
}

void tai::emitLaneTree(OpBuilder &builder, Location loc, AtomicKind kind,
                       Type type, Value lanes, Value first, int64_t step,
                       const AliasScopes &scopes) {
  IndexMath outside(builder, loc);
  Value stepValue = outside.constant(step);
  for (int64_t half = SumOrder::kLanes / 2; half >= SumOrder::kGroups;
       half /= 2) {
    auto at = [&](OpBuilder &b, Value lane) {
      return emitPointer(b, loc, getStorageType(type), lanes, lane);
    };
    scf::ForOp::create(
        builder, loc, first, outside.constant(half), stepValue, ValueRange(),
        [&](OpBuilder &b, Location, Value lane, ValueRange) {
          Value other = IndexMath(b, loc).add(lane, outside.constant(half));
          Value sum = emitCombination(
              b, loc, kind, emitLoad(b, loc, type, at(b, lane), scopes),
              emitLoad(b, loc, type, at(b, other), scopes));
          emitStore(b, loc, sum, at(b, lane), scopes);
          scf::YieldOp::create(b, loc);
        });
  }
}
