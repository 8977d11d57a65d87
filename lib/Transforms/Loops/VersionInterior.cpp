//===- VersionInterior.cpp - Loop versioning, away from borders -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A stencil tests at every cell whether it is at a border: to wrap an index, or
// to omit a neighbour. Along the innermost index the result is the same nearly
// everywhere, and the test prevents contiguous vector loads. This pass gives
// the loop a second body in which these conditions are constants, and
// `tai-split-index-sets` later runs it on the interior range alone.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/Index/IndexShift.h"
#include "tai/Analysis/IndexBounds.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_VERSIONINTERIOR
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

namespace {
/// A condition on the innermost loop index, and its truth value in the
/// interior.
struct Condition {
  Value value;
  bool answer;
};

/// The range of the innermost index in which all conditions of a loop are
/// constant.
struct Interior {
  int64_t lower, upper;
  SmallVector<Condition> conditions;
};
} // namespace

/// True if `value` depends on `iv` and on no other index of the loop.
static bool dependsOnlyOn(Value value, LoopBox &box, Value iv) {
  SmallVector<Value> variables;
  return collectIndexVariables(value, box.loop.getBody(), variables) &&
         variables.size() == 1 && variables.front() == iv;
}

/// Turns minima and maxima of indices, which cut indices off at a border, into
/// selects by a condition, so that the condition is treated like others.
static void expandExtrema(LoopBox &box, Value iv) {
  SmallVector<Operation *> extrema;
  box.loop.getBody().walk([&](Operation *op) {
    if (isa<arith::MinSIOp, arith::MaxSIOp>(op) &&
        dependsOnlyOn(op->getResult(0), box, iv))
      extrema.push_back(op);
  });
  for (Operation *op : extrema) {
    OpBuilder builder(op);
    Value first = op->getOperand(0), second = op->getOperand(1);
    Value isFirst = arith::CmpIOp::create(builder, op->getLoc(),
                                          isa<arith::MinSIOp>(op)
                                              ? arith::CmpIPredicate::slt
                                              : arith::CmpIPredicate::sgt,
                                          first, second);
    Value chosen =
        arith::SelectOp::create(builder, op->getLoc(), isFirst, first, second);
    op->getResult(0).replaceAllUsesWith(chosen);
    op->erase();
  }
}

/// Finds the truth values in the loop body that depend on `iv` and on no other
/// value that varies.
static SmallVector<Value> collectConditions(LoopBox &box, Value iv) {
  SmallVector<Value> conditions;
  box.loop.getBody().walk([&](Operation *op) {
    for (Value result : op->getResults()) {
      if (!result.getType().isInteger(1) || matchPattern(result, m_Constant()))
        continue;
      if (dependsOnlyOn(result, box, iv))
        conditions.push_back(result);
    }
  });
  return conditions;
}

/// Narrows `interior` to the range of indices in which `condition` is constant.
static bool narrow(Interior &interior, Value condition, Value iv) {
  std::optional<ConstantStretch> stretch =
      getConstantStretch(condition, iv, interior.lower, interior.upper);
  if (!stretch)
    return false;
  interior.lower = stretch->lower;
  interior.upper = stretch->upper;
  interior.conditions.push_back({condition, stretch->answer});
  return true;
}

/// Returns the interior of the loop, if it is worth a body of its own: there
/// are conditions, and the borders are thin.
static std::optional<Interior> findInterior(LoopBox &box, int64_t minLength) {
  unsigned last = box.ivs().size() - 1;
  Value iv = box.ivs()[last];
  int64_t length = box.upper[last] - box.lower[last];
  if (length < minLength)
    return std::nullopt;
  expandExtrema(box, iv);
  Interior interior{box.lower[last], box.upper[last], {}};
  for (Value condition : collectConditions(box, iv))
    if (!narrow(interior, condition, iv))
      return std::nullopt;
  int64_t inner = interior.upper - interior.lower;
  if (interior.conditions.empty() || inner == length ||
      inner < length - length / 4)
    return std::nullopt;
  return interior;
}

/// Puts the body of the loop into both arms of an `scf.if` that tests whether
/// the iteration is in the interior.
static void split(LoopBox &box, const Interior &interior) {
  Location loc = box.loop.getLoc();
  Block &body = box.body();
  OpBuilder builder = OpBuilder::atBlockBegin(&body);
  Value iv = box.ivs().back();
  auto constant = [&](int64_t value) -> Value {
    return arith::ConstantIndexOp::create(builder, loc, value);
  };
  Value above = arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::sge,
                                      iv, constant(interior.lower));
  Value below = arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::slt,
                                      iv, constant(interior.upper));
  Value inside = arith::AndIOp::create(builder, loc, above, below);
  auto branch = scf::IfOp::create(builder, loc, inside, /*withElse=*/true);
  branch->setAttr("tai.interior", builder.getDenseI64ArrayAttr(
                                      {interior.lower, interior.upper}));

  // The arm for the borders gets the original body.
  Block &border = branch.getElseRegion().front();
  border.getOperations().splice(border.begin(), body.getOperations(),
                                std::next(branch->getIterator()),
                                std::prev(body.end()));

  Block &fast = branch.getThenRegion().front();
  OpBuilder inner = OpBuilder::atBlockBegin(&fast);
  IRMapping mapping;
  for (Operation &op : border.without_terminator())
    inner.clone(op, mapping);
  inner.setInsertionPointToStart(&fast);
  for (const Condition &condition : interior.conditions) {
    Value clone = mapping.lookup(condition.value);
    Value known = arith::ConstantIntOp::create(
        inner, loc, static_cast<int64_t>(condition.answer), 1);
    clone.replaceAllUsesWith(known);
  }
}

namespace {
struct VersionInterior : tai::impl::VersionInteriorBase<VersionInterior> {
  using Base::Base;

  void runOnOperation() override {
    getOperation()->walk([&](ParallelForOp loop) {
      if (loop.getSerialize() || loop.getInOrder() ||
          loop.getInductionVars().empty() || checksIndices(loop))
        return;
      int64_t ops = 0;
      loop.getBody().walk([&](Operation *) { ++ops; });
      if (ops > maxOps)
        return;
      std::optional<LoopBox> box = getConstantBox(loop);
      if (!box)
        return;
      if (std::optional<Interior> interior = findInterior(*box, minLength))
        split(*box, *interior);
    });
  }
};
} // namespace
