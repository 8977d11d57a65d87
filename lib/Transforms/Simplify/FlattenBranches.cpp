//===- FlattenBranches.cpp - If-conversion of safe branches ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Turns `scf.if` into `arith.select` where both arms may run. A select keeps
// the reverse pass free of branches, and lets loops vectorise. An arm must not
// be speculated if it can fault, or if its values or derivatives can be
// infinite or NaN where it would not have run.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Remarks.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/FloatFacts.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Interfaces/Differentiable.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_FLATTENBRANCHES
#include "tai/Transforms/Passes.h.inc"
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

/// True if the result of `op`, and the derivative of the result, are finite
/// wherever the operands of `op` are.
static bool staysFinite(Operation *op, FloatFacts &facts) {
  if (mayHaveNonFinitePartial(op, facts))
    return false;
  // The result of `op` may be non-finite only where one of its operands is.
  return llvm::none_of(op->getResults(), [&](Value result) {
    return isFloatOrVector(result.getType()) && facts.mayBeNonFinite(result) &&
           llvm::none_of(op->getOperands(), [&](Value operand) {
             return isFloatOrVector(operand.getType()) &&
                    facts.mayBeNonFinite(operand);
           });
  });
}

/// True if values of the type can pass through `arith.select`.
static bool canSelect(Type type) {
  return type.isIntOrIndexOrFloat() || isa<VectorType>(type);
}

namespace {
struct FlattenBranches : tai::impl::FlattenBranchesBase<FlattenBranches> {
  using Base::Base;

  void runOnOperation() override {
    // Inner branches are flattened first, because a branch can only be
    // flattened if it contains no other branch.
    SmallVector<scf::IfOp> branches;
    walkOwned(getOperation(), [&](Operation *owned) {
      owned->walk<WalkOrder::PostOrder>(
          [&](scf::IfOp branch) { branches.push_back(branch); });
    });
    for (scf::IfOp branch : branches) {
      StringRef reason = findReasonToKeep(branch);
      report(branch, reason);
      if (reason.empty())
        flatten(branch);
    }
  }

  static void report(scf::IfOp branch, StringRef reason) {
    auto function = branch->getParentOfType<FunctionOpInterface>();
    auto options =
        remark::RemarkOpts::name(reason.empty() ? "flattened" : "kept")
            .category("tai-branches")
            .function(function ? function.getName() : "");
    if (reason.empty())
      remark::passed(branch.getLoc(), options)
          << remark::add("both arms run, and a select takes the result");
    else
      remark::missed(branch.getLoc(), options)
          << remark::add("the branch stays")
          << remark::metric("Reason", reason.str());
  }

  /// Returns the reason to keep the branch; empty if the branch is to be
  /// flattened.
  StringRef findReasonToKeep(scf::IfOp branch) {
    if (!llvm::all_of(branch.getResultTypes(), canSelect))
      return "a result has a type that cannot be selected";
    unsigned count = 0;
    FloatFacts facts;
    for (Region &region : branch->getRegions()) {
      if (region.empty())
        continue;
      for (Operation &op : region.front().without_terminator()) {
        if (op.getNumRegions() != 0)
          return "an arm holds a loop or a branch that stays";
        if (!mayRunAnyway(&op))
          return "an arm has an effect or can fault";
        if (force)
          continue;
        if (!staysFinite(&op, facts))
          return "a value or derivative can be infinite or NaN where its arm "
                 "does not run";
        if (!op.hasTrait<OpTrait::ConstantLike>() && ++count > maxOps)
          return "the arms are long";
      }
    }
    return "";
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
