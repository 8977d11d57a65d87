//===- RegisterTotal.cpp - A sum in a register ----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A register in the type of the terms, or in f64 (`wide`). A sum of n numbers,
// added one after another, has an error of about n roundings; in blocks of m
// numbers, the error is about sqrt(m n) roundings, and adding the blocks in f64
// costs almost nothing.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "tai/ABI/SumModes.h"
#include "tai/Conversion/TaiToHost/Lowering.h"
#include "tai/Conversion/TaiToHost/Reductions/TotalForm.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"

using namespace mlir;
using namespace mlir::tai;

/// Returns the type of partial sums: f32 for 16-bit floats, whose sums of equal
/// terms stop growing at 2048 terms; f64 for sums with more digits.
static Type getSumType(const TotalUpdates &sum) {
  Type type = sum.termType;
  if (!isa<FloatType>(type) || sum.kind != AtomicKind::Add)
    return type;
  if (sum.reduction.getDigits() != SumDigits::Own)
    return Float64Type::get(type.getContext());
  bool isNarrow = isa<Float16Type, BFloat16Type>(type);
  return isNarrow ? Float32Type::get(type.getContext()) : type;
}

/// Emits the combination of a and b by `kind`, as an op that gets no fast-math
/// flags: the order of such ops is part of the result in every mode.
static Value emitInOrder(OpBuilder &builder, Location loc, AtomicKind kind,
                         Value a, Value b) {
  if (isa<FloatType>(a.getType()))
    switch (kind) {
    case AtomicKind::Add:
      return LLVM::FAddOp::create(builder, loc, a, b);
    case AtomicKind::Mul:
      return LLVM::FMulOp::create(builder, loc, a, b);
    case AtomicKind::Min:
      return LLVM::MinimumOp::create(builder, loc, a, b);
    case AtomicKind::Max:
      return LLVM::MaximumOp::create(builder, loc, a, b);
    default:
      break;
    }
  return emitCombination(builder, loc, kind, a, b);
}

/// Lets LLVM reorder a sum over iterations, as its vectoriser requires; the
/// order is unspecified here. Marks the function for `WidenSums`.
static void freeOrder(Operation *addition) {
  using arith::FastMathFlags;
  Builder builder(addition->getContext());
  addition->setAttr("fastmath",
                    arith::FastMathFlagsAttr::get(builder.getContext(),
                                                  FastMathFlags::reassoc |
                                                      FastMathFlags::contract));
  auto function = addition->getParentOfType<LLVM::LLVMFuncOp>();
  SmallVector<Attribute> entries;
  if (ArrayAttr others = function.getPassthroughAttr())
    llvm::append_range(entries, others);
  Attribute mark = builder.getStringAttr(runtime::kFreeSumsAttrName);
  if (llvm::is_contained(entries, mark))
    return;
  entries.push_back(mark);
  function.setPassthroughAttr(builder.getArrayAttr(entries));
}

namespace {
class RegisterTotal final : public TotalForm {
public:
  explicit RegisterTotal(const TotalUpdates &sum)
      : TotalForm(sum), type(getSumType(sum)),
        totalType(isBlocked() ? Float64Type::get(type.getContext()) : type) {}

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
  bool isBlocked() const { return getBlockLength() != 0; }
  Value emitIdentity(OpBuilder &builder, Location loc, Type of) {
    return arith::ConstantOp::create(builder, loc, getIdentity(sum.kind, of));
  }

  /// The type of a sum over a block, and of the total over blocks and
  /// partitions.
  Type type, totalType;
  /// Memory of the sum over a block of iterations, and of the total of earlier
  /// blocks.
  Value slot, total;
};
} // namespace

void RegisterTotal::emitEntry(OpBuilder &builder, Location loc) {
  slot = emitStackSlots(builder, loc, 1);
  emitSlotStore(builder, loc, emitIdentity(builder, loc, type), slot);
  if (!isBlocked())
    return;
  total = emitStackSlots(builder, loc, 1);
  emitSlotStore(builder, loc, emitIdentity(builder, loc, totalType), total);
}

void RegisterTotal::emitTerm(OpBuilder &builder, Location loc, size_t number,
                             AtomicKind update, Value term, Place place) {
  Value old = emitSlotLoad(builder, loc, type, slot);
  term = emitWidened(builder, loc, term, type);
  Value next = emitCombination(builder, loc, update, old, term);
  if (sum.reduction.getOrder() == ReductionOrder::Any &&
      isa<arith::AddFOp, arith::SubFOp>(next.getDefiningOp()))
    freeOrder(next.getDefiningOp());
  emitSlotStore(builder, loc, next, slot);
}

void RegisterTotal::emitBlockEnd(OpBuilder &builder, Location loc,
                                 scf::ForOp loop) {
  if (!isBlocked())
    return;
  Value block = emitWidened(builder, loc,
                            emitSlotLoad(builder, loc, type, slot), totalType);
  Value before = emitSlotLoad(builder, loc, totalType, total);
  emitSlotStore(builder, loc,
                arith::AddFOp::create(builder, loc, before, block), total);
  emitSlotStore(builder, loc, emitIdentity(builder, loc, type), slot);
}

SmallVector<Value> RegisterTotal::emitPartial(OpBuilder &builder,
                                              Location loc) {
  emitBlockEnd(builder, loc, {});
  return {emitSlotLoad(builder, loc, totalType, isBlocked() ? total : slot)};
}

SmallVector<Value> RegisterTotal::emitNone(OpBuilder &builder, Location loc) {
  return {emitIdentity(builder, loc, totalType)};
}

SmallVector<Value> RegisterTotal::emitCombined(OpBuilder &builder, Location loc,
                                               ValueRange sums,
                                               ValueRange partial) {
  return {emitInOrder(builder, loc, sum.kind, sums.front(), partial.front())};
}

void RegisterTotal::emitUpdate(OpBuilder &builder, Location loc,
                               ValueRange total, Value address,
                               AliasScopes scopes) {
  Value result = total.front();
  if (sum.reduction.getDigits() == SumDigits::Own)
    return void(emitPlainUpdate(
        builder, loc, sum.kind,
        emitNarrowed(builder, loc, result, sum.termType), address, scopes));
  // The old value of the element is added in the wide type of the total, so
  // that the result is rounded only once.
  Value old = emitLoad(builder, loc, sum.termType, address, scopes);
  Value next = LLVM::FAddOp::create(
      builder, loc, emitWidened(builder, loc, old, result.getType()), result);
  emitStore(builder, loc, emitNarrowed(builder, loc, next, sum.termType),
            address, scopes);
}

std::unique_ptr<TotalForm> tai::createRegisterTotal(const TotalUpdates &sum) {
  return std::make_unique<RegisterTotal>(sum);
}
