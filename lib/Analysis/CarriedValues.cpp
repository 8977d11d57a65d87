//===- CarriedValues.cpp - Classifies loop-carried values -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The values of one iteration and those of the next are a system of equations,
// `next[i] = f(values)`. Equations that are a chain of exact steps from one
// unknown value are solved for that value, until none is left.
//
// Integers wrap, so that addition, exclusive or and multiplication by an odd
// number can be inverted exactly. Among float operations, only negation can:
// `(y + c) - c` is not `y`.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/CarriedValues.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"

using namespace mlir;
using namespace mlir::tai;

/// Returns the number of values that a loop carries from iteration to
/// iteration.
static unsigned getNumCarried(Operation *loop) {
  if (auto forOp = dyn_cast<scf::ForOp>(loop))
    return forOp.getNumRegionIterArgs();
  return cast<scf::WhileOp>(loop).getBeforeArguments().size();
}

CarriedValues::CarriedValues(Operation *loop)
    : loop(loop), values(getNumCarried(loop)) {
  SmallVector<bool> known(size(), false);
  for (unsigned i = 0; i != size(); ++i) {
    findClosedForm(i);
    known[i] = values[i].kind == CarriedKind::ClosedForm;
  }
  for (bool changed = true; changed;) {
    changed = false;
    for (unsigned i = 0; i != size(); ++i)
      changed |= invert(i, known);
    for (unsigned i = 0; i != size(); ++i)
      known[i] = values[i].kind != CarriedKind::Trajectory;
  }
}

std::optional<unsigned> CarriedValues::getIndex(Value value) const {
  auto argument = dyn_cast<BlockArgument>(value);
  if (!argument || argument.getOwner()->getParentOp() != loop)
    return {};
  unsigned index = argument.getArgNumber();
  if (isa<scf::ForOp>(loop))
    return index == 0 ? std::nullopt : std::optional(index - 1);
  auto whileOp = cast<scf::WhileOp>(loop);
  if (argument.getOwner() == whileOp.getBeforeBody())
    return index;
  return getIndex(whileOp.getConditionOp().getArgs()[index]);
}

Value CarriedValues::getNext(unsigned index) const {
  if (auto forOp = dyn_cast<scf::ForOp>(loop))
    return forOp.getYieldedValues()[index];
  return cast<scf::WhileOp>(loop).getYieldOp().getOperand(index);
}

bool CarriedValues::isInvariant(Value value) const {
  return !loop->isAncestor(value.getParentBlock()->getParentOp()) ||
         matchPattern(value, m_Constant());
}

/// True if `value` can be computed cheaply at the start of an iteration, from
/// the iteration number and the carried values marked in `known`.
bool CarriedValues::isComputable(Value value, ArrayRef<bool> known,
                                 unsigned budget) const {
  if (isInvariant(value))
    return true;
  if (std::optional<unsigned> index = getIndex(value))
    return known[*index];
  if (auto argument = dyn_cast<BlockArgument>(value))
    return isa<scf::ForOp>(loop) &&
           argument.getOwner()->getParentOp() == loop; // induction variable
  Operation *op = value.getDefiningOp();
  return budget != 0 && op->getParentOp() == loop && op->getNumRegions() == 0 &&
         isMemoryEffectFree(op) && isSpeculatable(op) &&
         llvm::all_of(op->getOperands(), [&](Value operand) {
           return isComputable(operand, known, budget / 2);
         });
}

/// Recognises steps whose repetition has a closed form: `x + k`, `x - k` and `x
/// ^ k`, where `k` is invariant.
void CarriedValues::findClosedForm(unsigned index) {
  Operation *op = getNext(index).getDefiningOp();
  if (!op || !isa<arith::AddIOp, arith::SubIOp, arith::XOrIOp>(op) ||
      !op->getResult(0).getType().isIntOrIndex())
    return;
  for (unsigned operand : {0u, 1u}) {
    if (operand == 1 && isa<arith::SubIOp>(op))
      continue;
    if (getIndex(op->getOperand(operand)) == index &&
        isInvariant(op->getOperand(1 - operand))) {
      values[index] = {CarriedKind::ClosedForm, {{op, operand}}, index};
      return;
    }
  }
}

/// Describes `op` as a step that can be inverted; none if its operand number
/// `operand` cannot be computed exactly from the result and the other operands.
static std::optional<CarriedStep> getInvertibleStep(Operation *op,
                                                    unsigned operand) {
  if (isa<arith::AddIOp, arith::SubIOp, arith::XOrIOp, arith::NegFOp>(op)) {
    if (op->getNumOperands() == 2 && op->getOperand(0) == op->getOperand(1))
      return std::nullopt;
    return CarriedStep{op, operand};
  }
  APInt factor;
  if (isa<arith::MulIOp>(op) &&
      matchPattern(op->getOperand(1 - operand), m_ConstantInt(&factor)) &&
      factor[0])
    return CarriedStep{op, operand, factor};
  return std::nullopt;
}

/// Solves the equation of carried value number `source` (next value =
/// f(values)) for another carried value that is still unknown. False if that is
/// impossible.
bool CarriedValues::invert(unsigned source, ArrayRef<bool> known) {
  constexpr unsigned kBudget = 64;
  for (const CarriedValue &solved : values)
    if (solved.kind == CarriedKind::Invertible && solved.source == source)
      return false;
  SmallVector<CarriedStep> steps;
  Value value = getNext(source);
  for (;;) {
    std::optional<unsigned> index = getIndex(value);
    if (index) {
      if (known[*index])
        return false;
      std::reverse(steps.begin(), steps.end());
      values[*index] = {CarriedKind::Invertible, std::move(steps), source};
      return true;
    }
    Operation *op = value.getDefiningOp();
    if (!op || op->getParentOp() != loop || steps.size() == 8 ||
        op->getNumResults() != 1)
      return false;
    std::optional<unsigned> unknown;
    for (auto [i, operand] : llvm::enumerate(op->getOperands())) {
      if (isComputable(operand, known, kBudget))
        continue;
      if (unknown)
        return false;
      unknown = i;
    }
    std::optional<CarriedStep> step =
        unknown ? getInvertibleStep(op, *unknown) : std::nullopt;
    if (!step)
      return false;
    steps.push_back(std::move(*step));
    value = op->getOperand(*unknown);
  }
}
