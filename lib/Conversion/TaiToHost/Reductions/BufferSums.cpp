//===- BufferSums.cpp - Sums of a part of a field -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Conversion/TaiToHost/Reductions/BufferSums.h"
#include "PairSums.h"
#include "tai/ABI/SumModes.h"
#include "tai/Conversion/TaiToHost/Reductions/TotalForm.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"
#include "tai/Transforms/Utils/IndexMath.h"

using namespace mlir;
using namespace mlir::tai;

/// Partial sums of two partitions must not share a cache line.
constexpr int64_t kCacheLine = 64;

FailureOr<BufferSums> BufferSums::create(AccumulationGroup group,
                                         ParallelForOp loop) {
  SmallVector<bool> fixed =
      llvm::map_to_vector(group.fixed, [](Value index) { return bool(index); });
  std::optional<FieldSlice> slice = FieldTable::getSlice(*group.field, fixed);
  if (!slice)
    return group.atomics.front().emitOpError(
        "updates a part of a field that is not evenly spaced in memory");
  BufferSums result(std::move(group), std::move(*slice));
  result.digits = result.group.atomics.front().getReductionAttr().getDigits();
  for (AtomicOp atomic : result.group.atomics)
    result.updatesPerIteration += estimateRuns(atomic, loop);
  return result;
}

int64_t BufferSums::getScalarBytes() const {
  switch (digits) {
  case SumDigits::Own:
    return group.field->scalarSize;
  case SumDigits::Wide:
    return sizeof(double);
  case SumDigits::Pair:
    return 2 * sizeof(double);
  }
  llvm_unreachable("unknown digits");
}

int32_t BufferSums::getCombineKind() const {
  Type scalar = group.field->scalarType;
  return digits == SumDigits::Pair ? kSumsPairs
         : scalar.isF16()          ? kSumsF16
         : scalar.isBF16()         ? kSumsBF16
         : isApart()               ? kSumsWide
         : scalar.isF64()          ? kSumsF64
         : scalar.isInteger(32)    ? kSumsI32
         : scalar.isInteger(64)    ? kSumsI64
                                   : kSumsF32;
}

/// Emits the address of the first element of the updated part of the field.
Value BufferSums::emitTarget(OpBuilder &builder, Location loc) {
  const FieldInfo &field = *group.field;
  IndexMath math(builder, loc);
  Value base = emitFieldBase(builder, loc, field);
  Value offset = math.constant(0);
  for (const IndexDigit &digit : field.storage.digits) {
    if (!slice.fixed[digit.dimension] || digit.extent == 1)
      continue;
    // Only the index of the digit's own dimension is needed here, since
    // emitDigit uses no other index.
    SmallVector<Value> zeroBased(field.layout.shape.size());
    zeroBased[digit.dimension] = math.sub(group.fixed[digit.dimension],
                                          field.layout.offset[digit.dimension]);
    Value value = emitDigit(builder, loc, field, digit, zeroBased);
    offset = math.add(offset, math.mul(value, digit.stride / field.scalarSize));
  }
  return emitPointer(builder, loc, getStorageType(field.scalarType), base,
                     offset);
}

void BufferSums::emitBefore(OpBuilder &builder, Location loc,
                            ModuleLowering &lowering, Value frame, Value parts,
                            Value single) {
  RuntimeCalls &runtime = lowering.runtime;
  target = emitTarget(builder, loc);
  int64_t bytes = getNumElements() * getScalarBytes();
  partStride = runtime.i64(builder, loc, llvm::alignTo(bytes, kCacheLine));
  if (isApart()) {
    memory = runtime.tai_rt_private(builder, loc, frame,
                                    runtime.i64(builder, loc, bytes), parts);
    return;
  }
  // A single partition adds to the field itself instead of to a buffer.
  auto choice = scf::IfOp::create(builder, loc,
                                  TypeRange{runtime.getPointerType()}, single,
                                  /*addThenBlock=*/true, /*addElseBlock=*/true);
  OpBuilder then = OpBuilder::atBlockBegin(choice.thenBlock());
  scf::YieldOp::create(then, loc, target);
  OpBuilder otherwise = OpBuilder::atBlockBegin(choice.elseBlock());
  Value own = runtime.tai_rt_private(otherwise, loc, frame,
                                     runtime.i64(otherwise, loc, bytes), parts);
  scf::YieldOp::create(otherwise, loc, own);
  memory = choice.getResult(0);
  if (!isContiguous())
    cellStride = arith::SelectOp::create(
        builder, loc, single, runtime.i64(builder, loc, slice.cellStride),
        runtime.i64(builder, loc, getCompactStride()));
}

void BufferSums::emitEntry(OpBuilder &builder, Location loc, Value part) {
  Value bytes = arith::MulIOp::create(builder, loc, part, partStride);
  base = emitPointer(builder, loc, builder.getI8Type(), memory, bytes);
}

void BufferSums::rewriteUpdates(ModuleLowering &lowering) {
  const FieldInfo &field = *group.field;
  // A buffer takes the alias scopes of its field: an access that cannot reach
  // the field cannot reach the buffer.
  AliasScopes scopes = lowering.fields.getScopes(field);
  for (AtomicOp atomic : group.atomics) {
    OpBuilder builder(atomic);
    Location loc = atomic.getLoc();
    IndexMath math(builder, loc);
    SmallVector<Value> zeroBased =
        emitZeroBased(builder, loc, field, atomic.getIndices());
    Value cell = math.constant(0);
    for (auto [digit, cells] :
         llvm::zip(field.storage.digits, slice.digitCells))
      if (cells != 0)
        cell = math.add(
            cell,
            math.mul(emitDigit(builder, loc, field, digit, zeroBased), cells));
    Type scalar =
        isApart() ? Float64Type::get(builder.getContext()) : field.scalarType;
    Type storage = getStorageType(scalar);
    Value address = base;
    if (isApart() || isContiguous()) {
      cell = math.mul(cell, field.numComponents);
    } else {
      Value bytes = math.mul(cell, math.toIndex(cellStride));
      address = emitPointer(builder, loc, builder.getI8Type(), address, bytes);
      cell = math.constant(0);
    }
    if (!atomic.getComponents().empty())
      cell = math.add(cell, emitComponent(builder, loc, field.elementShape,
                                          atomic.getComponents()));
    if (digits == SumDigits::Pair) {
      // In the buffer, the rounding errors follow all sums, so that sums of
      // neighbours are adjacent.
      address = emitPointer(builder, loc, storage, address, cell);
      Value restAt = emitPointer(builder, loc, storage, address,
                                 math.constant(getNumElements()));
      Value term = atomic.getValue();
      if (atomic.getKind() == AtomicKind::Sub)
        term = LLVM::FNegOp::create(builder, loc, term);
      Pair pair = {emitLoad(builder, loc, scalar, address, scopes),
                   emitLoad(builder, loc, scalar, restAt, scopes)};
      pair = emitPairSum(builder, loc, pair, term);
      emitStore(builder, loc, pair.sum, address, scopes);
      emitStore(builder, loc, pair.rest, restAt, scopes);
      atomic.erase();
      continue;
    }
    address = emitPointer(builder, loc, storage, address, cell);
    Value term = emitWidened(builder, loc, atomic.getValue(), scalar);
    emitPlainUpdate(builder, loc, atomic.getKind(), term, address, scopes);
    atomic.erase();
  }
}

void BufferSums::emitAfter(OpBuilder &builder, OpBuilder &whereSeveral,
                           Location loc, ModuleLowering &lowering, Value frame,
                           Value parts) {
  RuntimeCalls &runtime = lowering.runtime;
  OpBuilder &inside = isApart() ? builder : whereSeveral;
  Value kind = runtime.i32(inside, loc, getCombineKind());
  if (isContiguous()) {
    Value count = runtime.i64(inside, loc, getNumElements());
    runtime.tai_rt_combine(inside, loc, frame, target, memory, count, parts,
                           kind);
    return;
  }
  runtime.tai_rt_combine_strided(
      inside, loc, frame, target, memory,
      runtime.i64(inside, loc, slice.numCells),
      runtime.i64(inside, loc, group.field->numComponents),
      runtime.i64(inside, loc, slice.cellStride), parts, kind);
}
