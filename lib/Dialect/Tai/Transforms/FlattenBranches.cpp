//===- FlattenBranches.cpp - Safe branches to selects ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Turns `scf.if` into `arith.select` where both arms may run. A select keeps
// the reverse pass free of branches, and lets loops vectorise. Which arms may
// run is the whole question: an arm that can fault must not, and neither must
// one whose values or derivatives can be infinite or NaN where it would not
// have run.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/AD/Differentiable.h"
#include "tai/Analysis/FloatFacts.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Dialect/Tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_FLATTENBRANCHES
#include "tai/Dialect/Tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// True if `op` may run where the program would not have run it: it has no
/// effect and cannot fault. A read in bounds is no effect that matters here,
/// since neither arm writes.
static bool mayRunAnyway(Operation *op) {
  if (op->getNumRegions() != 0 || !isSpeculatable(op))
    return false;
  return isMemoryEffectFree(op) || isa<LoadOp>(op);
}

/// True if what `op` computes, and its derivative, are finite wherever its
/// operands are.
static bool staysFinite(Operation *op, FloatFacts &facts) {
  if (mayHaveNonFinitePartial(op, facts))
    return false;
  // A value that is already at risk outside stays where its condition is.
  return llvm::none_of(op->getResults(), [&](Value result) {
    return isFloatOrVector(result.getType()) && facts.mayBeNonFinite(result) &&
           llvm::none_of(op->getOperands(), [&](Value operand) {
             return isFloatOrVector(operand.getType()) &&
                    facts.mayBeNonFinite(operand);
           });
  });
}

/// True if the type can pass through `arith.select`.
static bool canSelect(Type type) {
  return type.isIntOrIndexOrFloat() || isa<VectorType>(type);
}

namespace {
struct FlattenBranches : tai::impl::FlattenBranchesBase<FlattenBranches> {
  using Base::Base;

  void runOnOperation() override {
    // Inner branches first: once flat they no longer hold back outer ones.
    SmallVector<scf::IfOp> branches;
    getOperation()->walk<WalkOrder::PostOrder>(
        [&](scf::IfOp branch) { branches.push_back(branch); });
    for (scf::IfOp branch : branches)
      if (canFlatten(branch))
        flatten(branch);
  }

  bool canFlatten(scf::IfOp branch) {
    if (!llvm::all_of(branch.getResultTypes(), canSelect))
      return false;
    unsigned count = 0;
    FloatFacts facts;
    for (Region &region : branch->getRegions()) {
      if (region.empty())
        continue;
      for (Operation &op : region.front().without_terminator()) {
        if (!mayRunAnyway(&op))
          return false;
        if (!force &&
            (!staysFinite(&op, facts) ||
             (!op.hasTrait<OpTrait::ConstantLike>() && ++count > maxOps)))
          return false;
      }
    }
    return true;
  }

  static void flatten(scf::IfOp branch) {
    OpBuilder builder(branch);
    SmallVector<SmallVector<Value>> yields;
    for (Region &region : branch->getRegions()) {
      if (region.empty())
        continue;
      Block &block = region.front();
      Operation *terminator = block.getTerminator();
      yields.emplace_back(terminator->getOperands());
      branch->getBlock()->getOperations().splice(
          branch->getIterator(), block.getOperations(), block.begin(),
          terminator->getIterator());
    }
    for (OpResult result : branch->getResults()) {
      unsigned i = result.getResultNumber();
      Value selected = arith::SelectOp::create(builder, branch.getLoc(),
                                               branch.getCondition(),
                                               yields[0][i], yields[1][i]);
      result.replaceAllUsesWith(selected);
    }
    branch.erase();
  }
};
} // namespace
