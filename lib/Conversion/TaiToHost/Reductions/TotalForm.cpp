//===- TotalForm.cpp - Forms of sums over all iterations ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Chooses the form of a sum by the reduction that the plan wrote to its
// updates.
//
//===----------------------------------------------------------------------===//

#include "tai/Conversion/TaiToHost/Reductions/TotalForm.h"
#include "mlir/Dialect/Arith/IR/Arith.h"

using namespace mlir;
using namespace mlir::tai;

std::unique_ptr<TotalForm> TotalForm::create(const TotalUpdates &sum) {
  if (sum.reduction.getOrder() == ReductionOrder::Common)
    return createLaneTotal(sum);
  constexpr bool F64 = true, Narrow = false;
#define TAI_PRECISE_TOTAL(rowKind, terms, rowDigits, form)                     \
  if (sum.kind == AtomicKind::rowKind && sum.termType.isF64() == terms &&      \
      sum.reduction.getDigits() == SumDigits::rowDigits)                       \
    return create##form(sum);
#include "tai/Analysis/Reductions/Forms.def"
  return createRegisterTotal(sum);
}

TotalUpdates::TotalUpdates(const Total &updates)
    : count(updates.size()), reduction(getReduction(updates.front())),
      kind(getCombiningKind(updates.front())),
      termType(getTermType(updates.front())) {}

Value tai::emitWidened(OpBuilder &builder, Location loc, Value value,
                       Type type) {
  if (value.getType() == type)
    return value;
  return arith::ExtFOp::create(builder, loc, type, value);
}

Value tai::emitNarrowed(OpBuilder &builder, Location loc, Value sum,
                        Type type) {
  if (sum.getType() == type)
    return sum;
  return arith::TruncFOp::create(builder, loc, type, sum);
}
