//===- Recomputation.cpp - Values of other iterations ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Recomputation.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Transforms/RegionUtils.h"

using namespace mlir;
using namespace mlir::tai;

Value Recomputation::get(Value value) {
  if (Value known = mapping.lookupOrNull(value))
    return known;
  Operation *op = value.getDefiningOp();
  if (!op || !loop->isProperAncestor(op))
    return value;
  for (Value operand : op->getOperands())
    get(operand);
  llvm::SetVector<Value> captured;
  getUsedValuesDefinedAbove(op->getRegions(), captured);
  for (Value operand : captured)
    get(operand);
  Operation *clone = builder.clone(*op, mapping);
  return clone->getResult(cast<OpResult>(value).getResultNumber());
}

Value tai::createZeroValue(OpBuilder &builder, Location loc, Type type) {
  return arith::ConstantOp::create(builder, loc, builder.getZeroAttr(type));
}

Value tai::recomputeUnder(Recomputation &at, Operation *op, Value value,
                          ArrayRef<scf::IfOp> conditions) {
  if (conditions.empty())
    return at.get(value);
  Location loc = op->getLoc();
  scf::IfOp original = conditions.front();
  bool inThen = original.getThenRegion().isAncestor(op->getParentRegion());
  Value condition = at.get(original.getCondition());
  auto branch = [&](bool taken) {
    return [&, taken](OpBuilder &builder, Location) {
      Value result;
      if (taken) {
        Recomputation inner(builder, at.loop, at.mapping);
        result = recomputeUnder(inner, op, value, conditions.drop_front());
      } else {
        result = createZeroValue(builder, loc, value.getType());
      }
      scf::YieldOp::create(builder, loc, result);
    };
  };
  return scf::IfOp::create(at.builder, loc, condition, branch(inThen),
                           branch(!inThen))
      .getResult(0);
}
