//===- SCFTangents.cpp - Forward mode of structured control flow ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An op that forwards values to and from its regions is rebuilt, with the
// tangents of these values after them; its regions are moved there and
// extended.
//
//===----------------------------------------------------------------------===//

#include "Models.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"

using namespace mlir;
using namespace mlir::tai;

/// Returns the positions of the values that may have a tangent.
static SmallVector<unsigned> getVaried(TangentBuilder &b, ValueRange values) {
  SmallVector<unsigned> positions;
  for (auto [i, value] : llvm::enumerate(values))
    if (b.isVaried(value))
      positions.push_back(i);
  return positions;
}

/// Returns `values`, followed by the tangents of the values at `positions`.
static SmallVector<Value> addTangents(TangentBuilder &b, ValueRange values,
                                      ArrayRef<unsigned> positions) {
  SmallVector<Value> all(values);
  for (unsigned i : positions)
    all.push_back(b.getTangentOrZero(values[i]));
  return all;
}

static SmallVector<Type> addTypes(ValueRange values,
                                  ArrayRef<unsigned> positions) {
  SmallVector<Type> types(values.getTypes());
  for (unsigned i : positions)
    types.push_back(values[i].getType());
  return types;
}

/// For each i in `positions`, adds the tangent of argument `first + i` to the
/// arguments of `block`.
static void addArguments(TangentBuilder &b, Block &block, unsigned first,
                         ArrayRef<unsigned> positions) {
  for (unsigned i : positions) {
    BlockArgument argument = block.getArgument(first + i);
    b.setTangent(argument,
                 block.addArgument(argument.getType(), argument.getLoc()));
  }
}

/// For each i in `positions`, appends the tangent of operand `first + i` to the
/// operands of the terminator.
static void extendTerminator(TangentBuilder &b, Operation *terminator,
                             unsigned first, ArrayRef<unsigned> positions) {
  OpBuilder::InsertionGuard guard(b);
  b.setInsertionPoint(terminator);
  SmallVector<Value> tangents;
  for (unsigned i : positions)
    tangents.push_back(b.getTangentOrZero(terminator->getOperand(first + i)));
  terminator->insertOperands(terminator->getNumOperands(), tangents);
}

/// Replaces `op` by `made`, whose last results are the tangents of the results
/// at `positions`.
static void finish(TangentBuilder &b, Operation *op, Operation *made,
                   ArrayRef<unsigned> positions) {
  unsigned own = op->getNumResults();
  made->setDiscardableAttrs(op->getDiscardableAttrDictionary());
  b.replace(op, made);
  for (auto [k, i] : llvm::enumerate(positions))
    b.setTangent(made->getResult(i), made->getResult(own + k));
}

LogicalResult mlir::tai::extendIf(scf::IfOp op, TangentBuilder &b) {
  SmallVector<unsigned> varied = getVaried(b, op.getResults());
  LogicalResult result = success();
  for (Region &region : op->getRegions()) {
    if (region.empty())
      continue;
    if (failed(b.extendBlock(&region.front())))
      result = failure();
    else if (!varied.empty())
      extendTerminator(b, region.front().getTerminator(), 0, varied);
  }
  if (varied.empty() || failed(result))
    return result;
  b.setInsertionPoint(op);
  auto made = scf::IfOp::create(b, addTypes(op.getResults(), varied),
                                op.getCondition(), /*addThenBlock=*/false,
                                /*addElseBlock=*/false);
  made.getThenRegion().takeBody(op.getThenRegion());
  made.getElseRegion().takeBody(op.getElseRegion());
  finish(b, op, made, varied);
  return success();
}

LogicalResult mlir::tai::extendFor(scf::ForOp op, TangentBuilder &b) {
  SmallVector<unsigned> varied = getVaried(b, op.getRegionIterArgs());
  if (varied.empty())
    return b.extendBlock(op.getBody());
  b.setInsertionPoint(op);
  auto made = scf::ForOp::create(
      b, op.getLowerBound(), op.getUpperBound(), op.getStep(),
      addTangents(b, op.getInitArgs(), varied), nullptr, op.getUnsignedCmp());
  made.getRegion().takeBody(op.getRegion());
  addArguments(b, *made.getBody(), made.getNumInductionVars(), varied);
  LogicalResult result = b.extendBlock(made.getBody());
  extendTerminator(b, made.getBody()->getTerminator(), 0, varied);
  finish(b, op, made, varied);
  return result;
}

LogicalResult mlir::tai::extendWhile(scf::WhileOp op, TangentBuilder &b) {
  Block *before = op.getBeforeBody(), *after = op.getAfterBody();
  SmallVector<unsigned> carried = getVaried(b, before->getArguments());
  SmallVector<unsigned> passed = getVaried(b, after->getArguments());
  b.setInsertionPoint(op);
  auto made = scf::WhileOp::create(b, addTypes(op.getResults(), passed),
                                   addTangents(b, op.getInits(), carried));
  made.getBefore().takeBody(op.getBefore());
  made.getAfter().takeBody(op.getAfter());
  addArguments(b, *before, 0, carried);
  addArguments(b, *after, 0, passed);
  LogicalResult first = b.extendBlock(before);
  LogicalResult second = b.extendBlock(after);
  extendTerminator(b, before->getTerminator(), /*the condition*/ 1, passed);
  extendTerminator(b, after->getTerminator(), 0, carried);
  finish(b, op, made, passed);
  return success(succeeded(first) && succeeded(second));
}

bool mlir::tai::isSumReduction(Region &region) {
  Block &block = region.front();
  auto result = cast<scf::ReduceReturnOp>(block.getTerminator()).getResult();
  auto add = result.getDefiningOp<arith::AddFOp>();
  Value first = block.getArgument(0), second = block.getArgument(1);
  return add && ((add.getLhs() == first && add.getRhs() == second) ||
                 (add.getLhs() == second && add.getRhs() == first));
}

LogicalResult mlir::tai::extendParallel(scf::ParallelOp op, TangentBuilder &b) {
  SmallVector<unsigned> varied = getVaried(b, op.getResults());
  if (failed(b.extendBlock(op.getBody())))
    return failure();
  if (varied.empty())
    return success();
  auto reduce = cast<scf::ReduceOp>(op.getBody()->getTerminator());
  for (unsigned i : varied)
    if (!isSumReduction(reduce.getReductions()[i])) {
      b.emitError(op, "cannot differentiate a reduction that is not a sum")
              .attachNote()
          << "carry the value through an 'scf.for'";
      return failure();
    }
  // For each sum that scf.reduce computes, a reduction that sums the tangents
  // is added.
  {
    OpBuilder::InsertionGuard guard(b);
    b.setInsertionPoint(reduce);
    auto extended =
        scf::ReduceOp::create(b, addTangents(b, reduce.getOperands(), varied));
    unsigned own = reduce.getNumOperands();
    for (auto [i, region] : llvm::enumerate(reduce.getReductions()))
      extended.getReductions()[i].takeBody(region);
    for (auto [k, i] : llvm::enumerate(varied)) {
      IRMapping mapping;
      Region &target = extended.getReductions()[own + k];
      target.getBlocks().clear();
      extended.getReductions()[i].cloneInto(&target, mapping);
    }
    reduce.erase();
  }
  b.setInsertionPoint(op);
  auto made = scf::ParallelOp::create(b, op.getLowerBound(), op.getUpperBound(),
                                      op.getStep(),
                                      addTangents(b, op.getInitVals(), varied));
  made.getRegion().takeBody(op.getRegion());
  finish(b, op, made, varied);
  return success();
}
