//===- Accumulation.cpp - Accumulations of parallel loops -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Reductions/Accumulation.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Cost.h"

using namespace mlir;
using namespace mlir::tai;

ReductionAttr tai::getReduction(Operation *update) {
  if (auto atomic = dyn_cast<AtomicOp>(update))
    return atomic.getReductionAttr();
  return dyn_cast_or_null<ReductionAttr>(
      update->getDiscardableAttr(kAccumulateAttrName));
}

bool tai::isKeptInRegister(Operation *update) {
  ReductionAttr reduction = getReduction(update);
  return reduction && reduction.getForm() == ReductionForm::Register;
}

AtomicKind tai::getCombiningKind(Operation *update) {
  auto atomic = dyn_cast<AtomicOp>(update);
  return atomic ? getCombiningKind(atomic.getKind()) : AtomicKind::Add;
}

Type tai::getTermType(Operation *update) {
  if (auto atomic = dyn_cast<AtomicOp>(update))
    return atomic.getValue().getType();
  if (auto lowered = dyn_cast<LLVM::AtomicRMWOp>(update))
    return lowered.getVal().getType();
  return cast<memref::AtomicRMWOp>(update).getValue().getType();
}

static bool areEqual(ValueRange a, ValueRange b) {
  return a.size() == b.size() &&
         llvm::all_of(llvm::zip_equal(a, b), [](auto pair) {
           auto [p, q] = pair;
           std::optional<int64_t> constant = getConstantIntValue(p);
           return p == q || (constant && constant == getConstantIntValue(q));
         });
}

/// True if one register can accumulate both updates: they have the same kind
/// and update the same element.
static bool haveOneTotal(Operation *a, Operation *b) {
  if (a->getName() != b->getName() ||
      getCombiningKind(a) != getCombiningKind(b))
    return false;
  if (auto atomic = dyn_cast<AtomicOp>(a))
    return updatesSameComponent(atomic, cast<AtomicOp>(b));
  if (auto lowered = dyn_cast<LLVM::AtomicRMWOp>(a))
    return lowered.getPtr() == cast<LLVM::AtomicRMWOp>(b).getPtr();
  auto x = cast<memref::AtomicRMWOp>(a), y = cast<memref::AtomicRMWOp>(b);
  return x.getMemref() == y.getMemref() &&
         areEqual(x.getIndices(), y.getIndices());
}

SmallVector<Total> tai::groupTotals(ArrayRef<Operation *> updates) {
  SmallVector<Total> totals;
  for (Operation *update : updates) {
    auto *known = llvm::find_if(totals, [&](const Total &total) {
      return haveOneTotal(total.front(), update);
    });
    if (known == totals.end())
      totals.push_back({update});
    else
      known->push_back(update);
  }
  return totals;
}

bool tai::hasCommonTotals(ParallelForOp loop) {
  return loop
      .walk([](Operation *op) {
        ReductionAttr reduction = getReduction(op);
        return reduction && reduction.getOrder() == ReductionOrder::Common
                   ? WalkResult::interrupt()
                   : WalkResult::advance();
      })
      .wasInterrupted();
}

/// Returns the number of the buffer to which an update adds, or none.
static std::optional<int64_t> getBuffer(AtomicOp atomic) {
  ReductionAttr reduction = atomic.getReductionAttr();
  return reduction ? reduction.getBuffer() : std::nullopt;
}

FailureOr<SmallVector<AccumulationGroup>>
tai::groupAccumulations(ParallelForOp loop, ArrayRef<AtomicOp> atomics,
                        FieldTable &fields) {
  SmallVector<AccumulationGroup> groups;
  for (AtomicOp atomic : atomics) {
    FailureOr<const FieldInfo *> field =
        fields.lookup(atomic, atomic.getFieldAttr());
    if (failed(field))
      return failure();
    SmallVector<Value> fixed;
    for (Value index : atomic.getIndices())
      fixed.push_back(loop.isDefinedOutsideOfLoop(index) ? index : Value());
    std::optional<int64_t> buffer = getBuffer(atomic);
    AccumulationGroup single{*field, fixed, {atomic}};
    auto *group = llvm::find_if(groups, [&](AccumulationGroup &other) {
      if (other.field != *field)
        return false;
      return buffer ? getBuffer(other.atomics.front()) == buffer
                    : other.fixed == fixed;
    });
    if (group == groups.end())
      groups.push_back(std::move(single));
    else
      mergeGroups(*group, single);
  }
  return groups;
}

void tai::mergeGroups(AccumulationGroup &into, const AccumulationGroup &from) {
  for (auto [a, b] : llvm::zip_equal(into.fixed, from.fixed)) {
    std::optional<int64_t> constant =
        a && b ? getConstantIntValue(a) : std::nullopt;
    if (a != b && !(constant && constant == getConstantIntValue(b)))
      a = Value();
  }
  llvm::append_range(into.atomics, from.atomics);
}

int64_t tai::getNumAccumulators(const AccumulationGroup &group) {
  int64_t count = group.field->numComponents;
  for (auto [extent, fixed] :
       llvm::zip_equal(group.field->layout.shape, group.fixed))
    count *= fixed ? 1 : extent;
  return count;
}

int64_t tai::getAccumulatorBytes(Type scalar) {
  return scalar.isF64() ? 20 : 12;
}

bool tai::updatesSameComponent(AtomicOp a, AtomicOp b) {
  return a.getField() == b.getField() &&
         areEqual(a.getIndices(), b.getIndices()) &&
         areEqual(a.getComponents(), b.getComponents());
}

bool tai::isInjective(ParallelForOp loop, ValueRange indices) {
  // Along a dimension with a single iteration, there are no iterations to
  // distinguish, so its index is left out.
  SmallVector<Value> ivs;
  for (auto [i, iv] : llvm::enumerate(loop.getInductionVars())) {
    std::optional<int64_t> lower, upper;
    if (!loop.isStructFor()) {
      lower = getConstantIntValue(loop.getLowerBounds()[i]);
      upper = getConstantIntValue(loop.getUpperBounds()[i]);
    }
    if (!lower || !upper || *upper - *lower > 1)
      ivs.push_back(iv);
  }
  return isInjectiveOver(getIndexExprs(indices), ivs);
}

double tai::estimateRuns(Operation *op, ParallelForOp loop) {
  double runs = 1;
  for (Operation *parent = op->getParentOp(); parent != loop;
       parent = parent->getParentOp())
    runs *= estimateTrips(parent);
  return runs;
}

double tai::estimateIteration(ParallelForOp loop, bool isIndependent) {
  double cost = estimateNanoseconds(loop.getBody().front());
  // Assumed gain of vectorisation: half the number of lanes, because gathers
  // and remainders cost the other half.
  constexpr double speedup = 4;
  WalkResult innerLoops = loop.getBody().walk(
      [](LoopLikeOpInterface) { return WalkResult::interrupt(); });
  return isIndependent && !innerLoops.wasInterrupted() ? cost / speedup : cost;
}

std::optional<int64_t> tai::getNumIterations(ParallelForOp loop) {
  if (loop.isStructFor())
    return std::nullopt;
  int64_t product = 1;
  for (auto [lower, upper] :
       llvm::zip(loop.getLowerBounds(), loop.getUpperBounds())) {
    std::optional<int64_t> from = getConstantIntValue(lower);
    std::optional<int64_t> to = getConstantIntValue(upper);
    if (!from || !to ||
        llvm::MulOverflow(product, std::max<int64_t>(0, *to - *from), product))
      return std::nullopt;
  }
  return product;
}

AtomicKind tai::getCombiningKind(AtomicKind kind) {
  return kind == AtomicKind::Sub ? AtomicKind::Add : kind;
}

TypedAttr tai::getIdentity(AtomicKind kind, Type type) {
  Builder builder(type.getContext());
  if (auto floatType = dyn_cast<FloatType>(type)) {
    const llvm::fltSemantics &semantics = floatType.getFloatSemantics();
    switch (kind) {
    case AtomicKind::Mul:
      return builder.getFloatAttr(floatType, 1.0);
    case AtomicKind::Min:
      return builder.getFloatAttr(floatType, llvm::APFloat::getInf(semantics));
    case AtomicKind::Max:
      return builder.getFloatAttr(floatType,
                                  llvm::APFloat::getInf(semantics, true));
    default:
      return builder.getFloatAttr(floatType, 0.0);
    }
  }
  unsigned width = type.getIntOrFloatBitWidth();
  switch (kind) {
  case AtomicKind::Mul:
    return builder.getIntegerAttr(type, llvm::APInt(width, 1));
  case AtomicKind::Min:
    return builder.getIntegerAttr(type, llvm::APInt::getSignedMaxValue(width));
  case AtomicKind::Max:
    return builder.getIntegerAttr(type, llvm::APInt::getSignedMinValue(width));
  case AtomicKind::And:
  case AtomicKind::MinU:
    return builder.getIntegerAttr(type, llvm::APInt::getAllOnes(width));
  default:
    return builder.getIntegerAttr(type, llvm::APInt::getZero(width));
  }
}
