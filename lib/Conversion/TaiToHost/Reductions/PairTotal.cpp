//===- PairTotal.cpp - Sums of f64 with twice the digits ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// LLVM must not reorder compensated sums, and does not vectorise a loop that
// forms one. So the loop over iterations stores its terms, which LLVM
// vectorises, and after each block of iterations the terms are summed in lanes.
//
//===----------------------------------------------------------------------===//

#include "PairSums.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "tai/Conversion/TaiToHost/Lowering.h"
#include "tai/Conversion/TaiToHost/Reductions/TotalForm.h"
#include "tai/Transforms/Utils/FieldAddress.h"
#include "tai/Transforms/Utils/IndexMath.h"

using namespace mlir;
using namespace mlir::tai;

/// Hides the computation of `x` from LLVM's optimisations.
static Value emitFenced(OpBuilder &builder, Location loc, Value x) {
  auto name = builder.getStringAttr("llvm.arithmetic.fence");
  return LLVM::CallIntrinsicOp::create(builder, loc, x.getType(), name,
                                       ValueRange{x})
      .getResult(0);
}

// If the term is a product, fusing the product into only one of its two uses
// would make the error that of a different term. CPU backends fuse only
// products with one use, so no fence is needed here, which would prevent
// vectorisation.
Pair tai::emitPairSum(OpBuilder &builder, Location loc, Pair pair, Value x) {
  auto add = [&](Value a, Value b) -> Value {
    return LLVM::FAddOp::create(builder, loc, a, b);
  };
  auto subtract = [&](Value a, Value b) -> Value {
    return LLVM::FSubOp::create(builder, loc, a, b);
  };
  Value sum = add(pair.sum, x);
  Value taken = subtract(sum, pair.sum);
  Value lost =
      add(subtract(pair.sum, subtract(sum, taken)), subtract(x, taken));
  return {sum, add(pair.rest, lost)};
}

Value tai::emitRounded(OpBuilder &builder, Location loc, Pair pair) {
  // An infinite sum has no rounding error: its error term is NaN.
  Value isNone = arith::CmpFOp::create(builder, loc, arith::CmpFPredicate::UNO,
                                       pair.rest, pair.rest);
  Value zero = arith::ConstantOp::create(
      builder, loc, builder.getFloatAttr(pair.rest.getType(), 0.0));
  Value rest = arith::SelectOp::create(builder, loc, isNone, zero, pair.rest);
  return LLVM::FAddOp::create(builder, loc, pair.sum, rest);
}

/// Emits additions to compensated sums in vector lanes. Half of the operations
/// are fused, for processors with separate units for additions and fused
/// operations. The products by one and minus one are exact; LLVM does not see
/// that these factors are constants.
static Pair emitPairSum(OpBuilder &builder, Location loc, Pair pair, Value x,
                        Value one, Value minusOne) {
  auto fused = [&](Value a, Value b, Value c) -> Value {
    return LLVM::FMulAddOp::create(builder, loc, a, b, c);
  };
  x = emitFenced(builder, loc, x);
  Value sum = LLVM::FAddOp::create(builder, loc, pair.sum, x);
  Value taken = fused(pair.sum, minusOne, sum);
  Value before = LLVM::FSubOp::create(builder, loc, sum, taken);
  Value lost = fused(fused(before, minusOne, pair.sum), one,
                     LLVM::FSubOp::create(builder, loc, x, taken));
  return {sum, LLVM::FAddOp::create(builder, loc, pair.rest, lost)};
}

namespace {
/// Keeps a compensated sum for each vector lane, and the terms of a block of
/// iterations.
class PairLanes {
public:
  /// Emitted at the entry of a function, for `updates` updates in each of the
  /// `block` iterations of a block.
  PairLanes(OpBuilder &builder, Location loc, size_t updates, int64_t block);

  /// Emitted at update number `update`, in the innermost loop: stores its term.
  /// Must run in every iteration; the term of a skipped update is zero.
  void emitTerm(OpBuilder &builder, Location loc, size_t update,
                scf::ForOp loop, Value term);
  /// Emitted after the innermost loop: sums the terms of the block.
  void emitBlockEnd(OpBuilder &builder, Location loc, scf::ForOp loop);
  /// Emits the sum over all vector lanes, with its rounding error.
  Pair emitTotal(OpBuilder &builder, Location loc);

private:
  static constexpr int64_t kLanes = 8;
  static constexpr int64_t kVectors = 2;

  VectorType type;
  /// For each update, the buffer in which a block of iterations stores its
  /// terms.
  SmallVector<Value> terms;
  SmallVector<Value> sums, rests;
};

class PairTotal final : public TotalForm {
public:
  explicit PairTotal(const TotalUpdates &sum)
      : TotalForm(sum), type(Float64Type::get(sum.termType.getContext())) {}

  bool storesTerms() const override { return getBlockLength() != 0; }
  unsigned getNumSlots() const override { return 2; }
  void emitEntry(OpBuilder &builder, Location loc) override;
  void emitTerm(OpBuilder &builder, Location loc, size_t number,
                AtomicKind update, Value term, Place place) override;
  void emitBlockEnd(OpBuilder &builder, Location loc, scf::ForOp loop) override;
  SmallVector<Value> emitPartial(OpBuilder &builder, Location loc) override;
  SmallVector<Value> emitNone(OpBuilder &builder, Location loc) override;
  SmallVector<Value> emitCombined(OpBuilder &builder, Location loc,
                                  ValueRange sums, ValueRange partial) override;
  void emitUpdate(OpBuilder &builder, Location loc, ValueRange total,
                  Value address, AliasScopes scopes) override;

private:
  Type type;
  /// Memory of the compensated sum: the sum, and the sum of its rounding
  /// errors.
  Value slot, rest;
  std::optional<PairLanes> lanes;
};
} // namespace

/// Emits the allocation of `count` vectors at the entry of the function.
static Value emitRoom(OpBuilder &builder, Location loc, VectorType type,
                      int64_t count) {
  Value size = LLVM::ConstantOp::create(builder, loc, builder.getI64Type(),
                                        builder.getI64IntegerAttr(count));
  return LLVM::AllocaOp::create(
      builder, loc, LLVM::LLVMPointerType::get(builder.getContext()), type,
      size, /*alignment=*/64);
}

PairLanes::PairLanes(OpBuilder &builder, Location loc, size_t updates,
                     int64_t block)
    : type(VectorType::get({kLanes}, builder.getF64Type())) {
  auto function =
      cast<LLVM::LLVMFuncOp>(builder.getInsertionBlock()->getParentOp());
  OpBuilder entry = OpBuilder::atBlockBegin(&function.getBody().front());
  // Room is allocated for zeros after the last terms, which fill whole vectors.
  for (size_t i = 0; i < updates; ++i)
    terms.push_back(emitRoom(entry, loc, type, block / kLanes + kVectors));
  Value zero =
      arith::ConstantOp::create(builder, loc, builder.getZeroAttr(type));
  for (int64_t v = 0; v < kVectors; ++v) {
    for (SmallVector<Value> *slots : {&sums, &rests}) {
      slots->push_back(emitRoom(entry, loc, type, 1));
      LLVM::StoreOp::create(builder, loc, zero, slots->back(), 64);
    }
  }
}

void PairLanes::emitTerm(OpBuilder &builder, Location loc, size_t update,
                         scf::ForOp loop, Value term) {
  Value position =
      IndexMath(builder, loc).sub(loop.getInductionVar(), loop.getLowerBound());
  Value address =
      emitPointer(builder, loc, builder.getF64Type(), terms[update], position);
  LLVM::StoreOp::create(builder, loc, term, address, 8);
}

void PairLanes::emitBlockEnd(OpBuilder &builder, Location loc,
                             scf::ForOp loop) {
  IndexMath math(builder, loc);
  Value zero = math.constant(0);
  Value count =
      math.max(math.sub(loop.getUpperBound(), loop.getLowerBound()), zero);
  Value zeros =
      arith::ConstantOp::create(builder, loc, builder.getZeroAttr(type));
  Type element = builder.getF64Type();
  for (Value kept : terms)
    for (int64_t v = 0; v < kVectors; ++v) {
      Value at = math.add(count, math.constant(v * kLanes));
      LLVM::StoreOp::create(builder, loc, zeros,
                            emitPointer(builder, loc, element, kept, at), 8);
    }
  auto number = [&](double value) {
    return emitFenced(builder, loc,
                      arith::ConstantOp::create(
                          builder, loc, DenseElementsAttr::get(type, value)));
  };
  Value one = number(1), minusOne = number(-1);
  auto add = scf::ForOp::create(builder, loc, zero, count,
                                math.constant(kLanes * kVectors));
  OpBuilder inside = OpBuilder::atBlockBegin(add.getBody());
  IndexMath at(inside, loc);
  for (int64_t v = 0; v < kVectors; ++v) {
    Pair pair = {LLVM::LoadOp::create(inside, loc, type, sums[v], 64),
                 LLVM::LoadOp::create(inside, loc, type, rests[v], 64)};
    for (Value kept : terms) {
      Value address =
          emitPointer(inside, loc, element, kept,
                      at.add(add.getInductionVar(), at.constant(v * kLanes)));
      Value x = LLVM::LoadOp::create(inside, loc, type, address, 8);
      pair = ::emitPairSum(inside, loc, pair, x, one, minusOne);
    }
    LLVM::StoreOp::create(inside, loc, pair.sum, sums[v], 64);
    LLVM::StoreOp::create(inside, loc, pair.rest, rests[v], 64);
  }
}

Pair PairLanes::emitTotal(OpBuilder &builder, Location loc) {
  Value zero =
      arith::ConstantOp::create(builder, loc, builder.getF64FloatAttr(0));
  Pair total = {zero, zero};
  for (int64_t v = 0; v < kVectors; ++v) {
    Value sum = LLVM::LoadOp::create(builder, loc, type, sums[v], 64);
    Value rest = LLVM::LoadOp::create(builder, loc, type, rests[v], 64);
    for (int32_t lane = 0; lane < kLanes; ++lane) {
      Value at = LLVM::ConstantOp::create(builder, loc, builder.getI32Type(),
                                          builder.getI32IntegerAttr(lane));
      auto pick = [&](Value vector) -> Value {
        return LLVM::ExtractElementOp::create(builder, loc, vector, at);
      };
      total = emitPairSum(builder, loc, total, pick(sum));
      total.rest = LLVM::FAddOp::create(builder, loc, total.rest, pick(rest));
    }
  }
  return total;
}

void PairTotal::emitEntry(OpBuilder &builder, Location loc) {
  Value none = emitNone(builder, loc).front();
  for (Value *number : {&slot, &rest}) {
    *number = emitStackSlots(builder, loc, 1);
    emitSlotStore(builder, loc, none, *number);
  }
  if (storesTerms())
    lanes.emplace(builder, loc, sum.count, getBlockLength());
}

void PairTotal::emitTerm(OpBuilder &builder, Location loc, size_t number,
                         AtomicKind update, Value term, Place place) {
  term = emitWidened(builder, loc, term, type);
  if (update == AtomicKind::Sub)
    term = LLVM::FNegOp::create(builder, loc, term);
  if (lanes)
    return lanes->emitTerm(builder, loc, number, place.loop, term);
  Pair pair = {emitSlotLoad(builder, loc, type, slot),
               emitSlotLoad(builder, loc, type, rest)};
  pair = emitPairSum(builder, loc, pair, term);
  emitSlotStore(builder, loc, pair.sum, slot);
  emitSlotStore(builder, loc, pair.rest, rest);
}

void PairTotal::emitBlockEnd(OpBuilder &builder, Location loc,
                             scf::ForOp loop) {
  if (lanes)
    lanes->emitBlockEnd(builder, loc, loop);
}

SmallVector<Value> PairTotal::emitPartial(OpBuilder &builder, Location loc) {
  if (!lanes)
    return {emitSlotLoad(builder, loc, type, slot),
            emitSlotLoad(builder, loc, type, rest)};
  Pair total = lanes->emitTotal(builder, loc);
  return {total.sum, total.rest};
}

SmallVector<Value> PairTotal::emitNone(OpBuilder &builder, Location loc) {
  Value none =
      arith::ConstantOp::create(builder, loc, getIdentity(sum.kind, type));
  return {none, none};
}

SmallVector<Value> PairTotal::emitCombined(OpBuilder &builder, Location loc,
                                           ValueRange sums,
                                           ValueRange partial) {
  Pair pair = emitPairSum(builder, loc, {sums[0], sums[1]}, partial[0]);
  return {pair.sum, LLVM::FAddOp::create(builder, loc, pair.rest, partial[1])};
}

void PairTotal::emitUpdate(OpBuilder &builder, Location loc, ValueRange total,
                           Value address, AliasScopes scopes) {
  // The old value of the element is added to the compensated sum, so that the
  // result is rounded only once.
  Value old = emitLoad(builder, loc, sum.termType, address, scopes);
  Pair next = emitPairSum(builder, loc, {total[0], total[1]}, old);
  emitStore(builder, loc, emitRounded(builder, loc, next), address, scopes);
}

std::unique_ptr<TotalForm> tai::createPairTotal(const TotalUpdates &sum) {
  return std::make_unique<PairTotal>(sum);
}
