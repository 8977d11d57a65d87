//===- LaneSums.cpp - Sums in the order of all targets --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "LaneSums.h"
#include "Lowering.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Transforms/Utils/Accumulate.h"
#include "tai/Transforms/Utils/IndexMath.h"
#include "tai/Transforms/Utils/SumOrder.h"

using namespace mlir;
using namespace mlir::tai;

LaneSum::LaneSum(AtomicKind kind, Type type)
    : kind(kind), type(getLaneType(kind, type)) {}

Value LaneSum::emitAddress(OpBuilder &builder, Location loc, Value base,
                           Value index) {
  return emitPointer(builder, loc, getStorageType(type), base, index);
}

void LaneSum::emitGroups(OpBuilder &builder, Location loc) {
  groups = emitStackSlots(builder, loc, SumOrder::kChunks * SumOrder::kGroups);
}

void LaneSum::emitLanes(OpBuilder &builder, Location loc) {
  lanes = emitStackSlots(builder, loc, SumOrder::kLanes);
}

void LaneSum::emitChunkStart(OpBuilder &builder, Location loc) {
  IndexMath math(builder, loc);
  Value none =
      arith::ConstantOp::create(builder, loc, getLaneStart(kind, type));
  scf::ForOp::create(builder, loc, math.constant(0),
                     math.constant(SumOrder::kLanes), math.constant(1),
                     ValueRange(),
                     [&](OpBuilder &b, Location, Value lane, ValueRange) {
                       emitStore(b, loc, none, emitAddress(b, loc, lanes, lane),
                                 AliasScopes());
                       scf::YieldOp::create(b, loc);
                     });
}

void LaneSum::emitTerm(OpBuilder &builder, Location loc, AtomicKind update,
                       Value term, Value lane) {
  if (term.getType() != type)
    term = arith::ExtFOp::create(builder, loc, type, term);
  emitPlainUpdate(builder, loc, update, term,
                  emitAddress(builder, loc, lanes, lane), AliasScopes());
}

void LaneSum::emitChunkEnd(OpBuilder &builder, Location loc, Value chunk) {
  IndexMath math(builder, loc);
  emitLaneTree(builder, loc, kind, type, lanes, math.constant(0), 1);
  for (int64_t group = 0; group < SumOrder::kGroups; ++group) {
    Value from = math.constant(group);
    Value to = math.add(math.mul(chunk, SumOrder::kGroups), from);
    Value number =
        emitLoad(builder, loc, type, emitAddress(builder, loc, lanes, from),
                 AliasScopes());
    emitStore(builder, loc, number, emitAddress(builder, loc, groups, to),
              AliasScopes());
  }
}

Value LaneSum::emitTotal(OpBuilder &builder, Location loc, Value chunks) {
  IndexMath math(builder, loc);
  Value none =
      arith::ConstantOp::create(builder, loc, getLaneStart(kind, type));
  auto total = scf::ForOp::create(
      builder, loc, math.constant(0), math.mul(chunks, SumOrder::kGroups),
      math.constant(1), none,
      [&](OpBuilder &b, Location, Value group, ValueRange sums) {
        Value number = emitLoad(
            b, loc, type, emitAddress(b, loc, groups, group), AliasScopes());
        scf::YieldOp::create(
            b, loc, emitCombination(b, loc, kind, sums.front(), number));
      });
  return total.getResult(0);
}
