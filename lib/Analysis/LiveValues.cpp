//===- LiveValues.cpp - Liveness of values --------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A carried value that feeds only itself is dead, but no local rewrite detects
// that, least of all through nested loops. Here liveness is tracked for each
// single result of a branch and each single value of a loop.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/CarriedValues.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

/// True for ops that have no effects besides the effects of the ops inside.
static bool isStructure(Operation *op) {
  return isa<scf::ForOp, scf::IfOp, scf::WhileOp, scf::ParallelOp,
             ParallelForOp>(op);
}

/// True for terminators whose operands are live only if the corresponding
/// results of the op around them are.
static bool isForwarding(Operation *op) {
  return isa<scf::YieldOp, scf::ConditionOp>(op) &&
         isa<scf::ForOp, scf::IfOp, scf::WhileOp>(op->getParentOp());
}

LiveValues::LiveValues(Region &region) : region(region) {
  region.walk([&](Operation *op) {
    if (isStructure(op) || isForwarding(op))
      return;
    if (op->hasTrait<OpTrait::IsTerminator>() || !wouldOpBeTriviallyDead(op)) {
      markOperands(op);
      markControl(op);
    }
  });
  while (!worklist.empty())
    visit(worklist.pop_back_val());
}

void LiveValues::mark(Value value) {
  if (region.isAncestor(value.getParentRegion()) && live.insert(value).second)
    worklist.push_back(value);
}

void LiveValues::markOperands(Operation *op) {
  op->walk([&](Operation *nested) {
    for (Value operand : nested->getOperands())
      mark(operand);
  });
}

/// Marks as live the values that decide whether and how often the op `inside`
/// runs.
void LiveValues::markControl(Operation *inside) {
  for (Operation *parent = inside->getParentOp();
       parent && region.isAncestor(parent->getParentRegion());
       parent = parent->getParentOp()) {
    if (!controlled.insert(parent).second)
      return;
    if (auto loop = dyn_cast<scf::ForOp>(parent)) {
      mark(loop.getLowerBound());
      mark(loop.getUpperBound());
      mark(loop.getStep());
    } else if (auto branch = dyn_cast<scf::IfOp>(parent)) {
      mark(branch.getCondition());
    } else if (auto loop = dyn_cast<scf::WhileOp>(parent)) {
      mark(loop.getConditionOp().getCondition());
    } else {
      for (Value operand : parent->getOperands())
        mark(operand);
    }
  }
}

void LiveValues::visit(Value value) {
  if (auto argument = dyn_cast<BlockArgument>(value))
    return visitArgument(argument);
  markControl(value.getDefiningOp());
  visitResult(cast<OpResult>(value));
}

void LiveValues::visitResult(OpResult result) {
  Operation *op = result.getOwner();
  unsigned index = result.getResultNumber();
  if (auto loop = dyn_cast<scf::ForOp>(op)) {
    mark(loop.getRegionIterArg(index));
    markControl(loop.getBody()->getTerminator());
  } else if (auto branch = dyn_cast<scf::IfOp>(op)) {
    mark(branch.getCondition());
    for (Region &arm : branch->getRegions())
      if (!arm.empty())
        mark(arm.front().getTerminator()->getOperand(index));
  } else if (auto loop = dyn_cast<scf::WhileOp>(op)) {
    mark(loop.getConditionOp().getArgs()[index]);
    markControl(loop.getConditionOp());
  } else {
    markOperands(op);
  }
}

void LiveValues::visitArgument(BlockArgument argument) {
  Operation *op = argument.getOwner()->getParentOp();
  unsigned index = argument.getArgNumber();
  if (argument.getOwner()->getParent() == &region)
    return;
  markControl(argument.getOwner()->getTerminator());
  if (auto loop = dyn_cast<scf::ForOp>(op)) {
    if (index != 0) { // not the induction variable
      mark(loop.getInitArgs()[index - 1]);
      mark(loop.getYieldedValues()[index - 1]);
    }
  } else if (auto loop = dyn_cast<scf::WhileOp>(op)) {
    if (argument.getOwner() == loop.getBeforeBody()) {
      mark(loop.getInits()[index]);
      mark(loop.getYieldOp().getOperand(index));
    } else {
      mark(loop.getConditionOp().getArgs()[index]);
    }
  } else if (!isa<scf::ParallelOp, ParallelForOp>(op)) {
    markOperands(op);
  }
}
