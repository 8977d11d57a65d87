//===- IntegerRanges.cpp - Ranges of integers -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Index/IntegerRanges.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Analysis/LoopBox.h"

using namespace mlir;
using namespace mlir::tai;

/// Limit of the depth to which chains of operations are followed.
static constexpr unsigned kMostDepth = 64;

static ConstantIntRanges getWhole(Value value) {
  return ConstantIntRanges::maxRange(
      ConstantIntRanges::getStorageBitwidth(value.getType()));
}

/// Returns the range from the smallest value of `low` to the largest value of
/// `up` minus one; `low` if this is empty, since there is then no index.
static ConstantIntRanges getBetween(const ConstantIntRanges &low,
                                    const ConstantIntRanges &up,
                                    bool isUnsigned) {
  const APInt &first = isUnsigned ? low.umin() : low.smin();
  APInt last = isUnsigned ? up.umax() : up.smax();
  if (isUnsigned ? last.ule(first) : last.sle(first))
    return low;
  --last;
  return isUnsigned ? ConstantIntRanges::fromUnsigned(first, last)
                    : ConstantIntRanges::fromSigned(first, last);
}

std::optional<ConstantIntRanges>
IntegerRanges::getLoopIndex(BlockArgument argument, unsigned depth) {
  Operation *parent = argument.getOwner()->getParentOp();
  if (auto loop = dyn_cast_or_null<scf::ForOp>(parent)) {
    // The loop index is less than the upper bound, also if the step is larger
    // than one.
    if (argument != loop.getInductionVar())
      return std::nullopt;
    return getBetween(get(loop.getLowerBound(), depth),
                      get(loop.getUpperBound(), depth), loop.getUnsignedCmp());
  }
  auto loop = dyn_cast_or_null<ParallelForOp>(parent);
  if (!loop)
    return std::nullopt;
  unsigned number = argument.getArgNumber();
  if (!loop.isStructFor())
    return getBetween(get(loop.getLowerBounds()[number], depth),
                      get(loop.getUpperBounds()[number], depth),
                      /*isUnsigned=*/false);
  std::optional<LoopBox> box = getIndexBox(loop);
  if (!box || box->lower[number] >= box->upper[number])
    return std::nullopt;
  return ConstantIntRanges::fromSigned(
      APInt(64, static_cast<uint64_t>(box->lower[number])),
      APInt(64, static_cast<uint64_t>(box->upper[number] - 1)));
}

ConstantIntRanges IntegerRanges::compute(Value value, unsigned depth) {
  if (oracle)
    if (std::optional<ConstantIntRanges> range = oracle(value))
      return *range;
  if (depth == kMostDepth)
    return getWhole(value);
  if (auto argument = dyn_cast<BlockArgument>(value))
    return getLoopIndex(argument, depth + 1).value_or(getWhole(value));
  Operation *op = value.getDefiningOp();
  if (auto branch = dyn_cast<scf::IfOp>(op)) {
    unsigned number = cast<OpResult>(value).getResultNumber();
    return get(branch.thenYield().getOperand(number), depth + 1)
        .rangeUnion(get(branch.elseYield().getOperand(number), depth + 1));
  }
  auto inferrable = dyn_cast<InferIntRangeInterface>(op);
  if (!inferrable)
    return getWhole(value);
  SmallVector<ConstantIntRanges> operands;
  for (Value operand : op->getOperands())
    operands.push_back(get(operand, depth + 1));
  std::optional<ConstantIntRanges> found;
  inferrable.inferResultRanges(
      operands, [&](Value result, const ConstantIntRanges &range) {
        if (result == value)
          found = range;
      });
  return found.value_or(getWhole(value));
}

ConstantIntRanges IntegerRanges::get(Value value, unsigned depth) {
  auto at = known.find(value);
  if (at != known.end())
    return at->second;
  // The value may depend on itself through a loop: until its range is computed,
  // it counts as unbounded.
  known.insert({value, getWhole(value)});
  ConstantIntRanges range = compute(value, depth);
  known.find(value)->second = range;
  return range;
}
