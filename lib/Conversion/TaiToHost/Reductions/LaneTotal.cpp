//===- LaneTotal.cpp - Sums in the order of all targets -------------------===//
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

#include "tai/Conversion/TaiToHost/Lowering.h"
#include "tai/Conversion/TaiToHost/Reductions/TotalForm.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"
#include "tai/Transforms/Utils/IndexMath.h"
#include "tai/Transforms/Utils/SumOrder.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
class LaneTotal final : public TotalForm {
public:
  explicit LaneTotal(const TotalUpdates &sum)
      : TotalForm(sum), kind(sum.kind),
        type(getLaneType(sum.kind, sum.termType)) {}

  /// A partition needs no slots for partial sums: chunks leave their sums in
  /// `groups`.
  unsigned getNumSlots() const override { return 0; }
  /// Emits the allocation of memory for the groups of all chunks.
  void emitBefore(OpBuilder &builder, Location loc) override;
  void emitEntry(OpBuilder &builder, Location loc) override;
  void emitTerm(OpBuilder &builder, Location loc, size_t number,
                AtomicKind update, Value term, Place place) override;
  void emitChunkStart(OpBuilder &builder, Location loc) override;
  void emitChunkEnd(OpBuilder &builder, Location loc, Value chunk) override;
  Value emitChunksTotal(OpBuilder &builder, Location loc,
                        Value chunks) override;
  void emitUpdate(OpBuilder &builder, Location loc, ValueRange total,
                  Value address, AliasScopes scopes) override;

private:
  Value emitAddress(OpBuilder &builder, Location loc, Value base, Value index);

  AtomicKind kind;
  /// The type of the lanes (partial sums) and of their total.
  Type type;
  Value groups, lanes;
};
} // namespace

Value LaneTotal::emitAddress(OpBuilder &builder, Location loc, Value base,
                             Value index) {
  return emitPointer(builder, loc, getStorageType(type), base, index);
}

void LaneTotal::emitBefore(OpBuilder &builder, Location loc) {
  groups = emitStackSlots(builder, loc, SumOrder::kChunks * SumOrder::kGroups);
}

void LaneTotal::emitEntry(OpBuilder &builder, Location loc) {
  lanes = emitStackSlots(builder, loc, SumOrder::kLanes);
}

void LaneTotal::emitChunkStart(OpBuilder &builder, Location loc) {
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

void LaneTotal::emitTerm(OpBuilder &builder, Location loc, size_t number,
                         AtomicKind update, Value term, Place place) {
  Value lane = IndexMath(builder, loc)
                   .sub(place.loop.getInductionVar(), place.firstLane);
  term = emitWidened(builder, loc, term, type);
  emitPlainUpdate(builder, loc, update, term,
                  emitAddress(builder, loc, lanes, lane), AliasScopes());
}

void LaneTotal::emitChunkEnd(OpBuilder &builder, Location loc, Value chunk) {
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

Value LaneTotal::emitChunksTotal(OpBuilder &builder, Location loc,
                                 Value chunks) {
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

void LaneTotal::emitUpdate(OpBuilder &builder, Location loc, ValueRange total,
                           Value address, AliasScopes scopes) {
  emitPlainUpdate(builder, loc, kind,
                  emitNarrowed(builder, loc, total.front(), sum.termType),
                  address, scopes);
}

std::unique_ptr<TotalForm> tai::createLaneTotal(const TotalUpdates &sum) {
  return std::make_unique<LaneTotal>(sum);
}
