//===- AccessLowering.cpp - State of access lowerings ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "AccessLowering.h"
#include "mlir/Dialect/Arith/Utils/Utils.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/ABI/Abi.h"
#include "tai/Analysis/IndexedAccess.h"
#include "tai/Support/BoundsMode.h"

using namespace mlir;
using namespace mlir::tai;

Value AccessLowering::getFieldBase(const FieldInfo &field) {
  Value &base = bases[&field];
  if (!base) {
    auto builder = OpBuilder::atBlockBegin(&function.getFunctionBody().front());
    base = emitFieldBase(builder, function.getLoc(), field);
  }
  return base;
}

Value AccessLowering::getTreeBase(const FieldInfo &field) {
  Value &base = trees[field.layout.tree];
  if (!base) {
    auto builder = OpBuilder::atBlockBegin(&function.getFunctionBody().front());
    base = emitTreeBase(builder, function.getLoc(), field);
  }
  return base;
}

Value AccessLowering::emitActivation(OpBuilder &builder, Location loc,
                                     const FieldInfo &field,
                                     ValueRange zeroBased) {
  const SparseInfo &sparse = field.sparse.back();
  Value tree = getTreeBase(field);
  Value cell = emitCellNumber(builder, loc, field, sparse.level, zeroBased);
  CellRef at = sparse.at(tree, cell);
  Value isActive = sparse.type.emitIsActive(builder, loc, at);
  if (auto kernel = dyn_cast<KernelOp>(function.getOperation());
      kernel && kernel.getKeepsActivity())
    return isActive;
  auto branch = scf::IfOp::create(builder, loc, builder.getI1Type(), isActive,
                                  /*addThenBlock=*/true, /*addElseBlock=*/true);
  OpBuilder inside = OpBuilder::atBlockBegin(branch.thenBlock());
  scf::YieldOp::create(inside, loc, isActive);
  OpBuilder outside = OpBuilder::atBlockBegin(branch.elseBlock());
  Value done = sparse.type.emitActivate(outside, loc, at);
  scf::YieldOp::create(outside, loc, done);
  return branch.getResult(0);
}

/// Collects the casts from floats to integers from which the indices are
/// computed.
static SmallVector<Operation *> findCasts(ValueRange indices) {
  llvm::SetVector<Value> pending(indices.begin(), indices.end());
  SmallVector<Operation *> casts;
  for (size_t i = 0; i != pending.size(); ++i) {
    Operation *op = pending[i].getDefiningOp();
    if (isa_and_present<arith::FPToSIOp, arith::FPToUIOp>(op))
      casts.push_back(op);
    else if (op && op->getNumRegions() == 0 && isPure(op))
      for (Value operand : op->getOperands())
        if (operand.getType().isIntOrIndex())
          pending.insert(operand);
  }
  return casts;
}

/// Emits an assertion that every float cast to an integer for an index is in
/// the integer's range: a cast of any other float yields an arbitrary number,
/// which may be a valid index. Null where the indices contain no casts.
Value AccessLowering::checkCasts(OpBuilder &builder, Location loc,
                                 ValueRange indices, const Twine &what,
                                 ValueRange whatShows) {
  Value all;
  for (Operation *op : findCasts(indices)) {
    Value value = op->getOperand(0);
    auto type = cast<FloatType>(value.getType());
    unsigned width = op->getResult(0).getType().getIntOrFloatBitWidth();
    bool isSigned = isa<arith::FPToSIOp>(op);
    // The bounds of integer types are zero or powers of two, which floats
    // represent exactly; bounds above the float's range round towards zero.
    auto limit = [&](double number) -> Value {
      APFloat bound(number);
      bool ignored;
      bound.convert(type.getFloatSemantics(), APFloat::rmTowardZero, &ignored);
      return arith::ConstantOp::create(builder, loc,
                                       builder.getFloatAttr(type, bound));
    };
    double high = std::ldexp(1.0, int(width - isSigned));
    double low = isSigned ? -high : 0;
    using Predicate = arith::CmpFPredicate;
    Value above =
        arith::CmpFOp::create(builder, loc, Predicate::OGE, value, limit(low));
    Value below =
        arith::CmpFOp::create(builder, loc, Predicate::OLT, value, limit(high));
    Value holds = arith::AndIOp::create(builder, loc, above, below);
    SmallVector<Value> shown{value};
    llvm::append_range(shown, whatShows);
    AssertOp::create(
        builder, loc, holds,
        builder.getStringAttr("{} is no index: as an integer it is out of "
                              "range for " +
                              what),
        shown, builder.getI32IntegerAttr(TAI_FAIL_INDEX));
    all = all ? arith::AndIOp::create(builder, loc, all, holds).getResult()
              : holds;
  }
  return all;
}

Value AccessLowering::checkRange(Operation *op, ValueRange zeroBased,
                                 ArrayRef<OpFoldResult> extents,
                                 const Twine &what, ValueRange shown) {
  if (!boundsCheck || op->hasAttr(kInRangeAttrName))
    return {};
  OpBuilder builder(op);
  Location loc = op->getLoc();
  // The message `what` also shows the extents that become known only at the
  // launch.
  SmallVector<Value> whatShows;
  for (OpFoldResult extent : extents)
    if (Value value = dyn_cast<Value>(extent))
      whatShows.push_back(value);
  Value inRange = checkCasts(builder, loc, shown, what, whatShows);
  for (auto [index, extent] : llvm::zip(zeroBased, extents)) {
    Value bound = getValueOrCreateConstantIndexOp(builder, loc, extent);
    Value holds = arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::ult,
                                        index, bound);
    inRange =
        inRange
            ? arith::AndIOp::create(builder, loc, inRange, holds).getResult()
            : holds;
  }
  if (!inRange)
    return {};
  std::string message = "index [";
  llvm::raw_string_ostream os(message);
  llvm::interleaveComma(shown, os, [&](Value) { os << "{}"; });
  os << "] is out of range for " << what;
  SmallVector<Value> all = llvm::to_vector(shown);
  llvm::append_range(all, whatShows);
  AssertOp::create(builder, loc, inRange, builder.getStringAttr(message), all,
                   builder.getI32IntegerAttr(TAI_FAIL_INDEX));
  return inRange;
}

Value AccessLowering::checkElement(FieldAccessOpInterface op,
                                   const FieldInfo &field,
                                   ValueRange zeroBased) {
  OpBuilder builder(op);
  SmallVector<OpFoldResult> extents =
      getAsIndexOpFoldResult(builder.getContext(), field.layout.shape);
  Value inRange = checkRange(op, zeroBased, extents,
                             describeField(field.layout), op.getIndices());
  ValueRange components = op.getComponents();
  if (!boundsCheck || op->hasAttr(kInRangeAttrName) ||
      llvm::all_of(components, [](Value component) {
        return getConstantIntValue(component).has_value();
      }))
    return inRange;
  extents = getAsIndexOpFoldResult(builder.getContext(), field.elementShape);
  Value inElement =
      checkRange(op, components, extents,
                 describeElement(FieldOp(field.layout.field)), components);
  return inRange
             ? arith::AndIOp::create(builder, op->getLoc(), inRange, inElement)
                   .getResult()
             : inElement;
}

Value tai::emitWhere(OpBuilder &builder, Operation *op, Value condition,
                     function_ref<Value(OpBuilder &)> access) {
  Location loc = op->getLoc();
  if (!op->getNumResults() || op->getResult(0).use_empty()) {
    auto branch = scf::IfOp::create(builder, loc, condition);
    OpBuilder inside = branch.getThenBodyBuilder();
    access(inside);
    return {};
  }
  auto branch = scf::IfOp::create(builder, loc, op->getResultTypes(), condition,
                                  /*addThenBlock=*/true, /*addElseBlock=*/true);
  OpBuilder inside = OpBuilder::atBlockBegin(branch.thenBlock());
  Value value = access(inside);
  scf::YieldOp::create(inside, loc, value);
  OpBuilder outside = OpBuilder::atBlockBegin(branch.elseBlock());
  Value zero = arith::ConstantOp::create(
      outside, loc, outside.getZeroAttr(op->getResult(0).getType()));
  scf::YieldOp::create(outside, loc, zero);
  return branch.getResult(0);
}

void AccessLowering::replaceGuarded(PatternRewriter &rewriter, Operation *op,
                                    Value inRange,
                                    function_ref<Value(OpBuilder &)> access) {
  Value value =
      inRange ? emitWhere(rewriter, op, inRange, access) : access(rewriter);
  if (op->getNumResults() && value)
    rewriter.replaceAllUsesWith(op->getResult(0), value);
  rewriter.eraseOp(op);
}
