//===- Appends.cpp - A new cell, and a store to it ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Splits tai.append into an op that lengthens the list and a store to the new
// cell, which is then scalarised like any other.
//
//===----------------------------------------------------------------------===//

#include "Scalarizer.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"
#include "tai/Transforms/Utils/IndexMath.h"

using namespace mlir;
using namespace mlir::tai;

static LogicalResult expandAppend(AppendOp append, FieldTable &fields) {
  OpBuilder builder(append);
  Location loc = append.getLoc();
  FailureOr<const FieldInfo *> found =
      fields.lookup(append, append.getFieldAttr());
  if (failed(found))
    return failure();
  const FieldInfo &field = **found;
  if (field.sparse.empty() || !field.sparse.back().type.isList())
    return append.emitOpError("appends to the field ")
           << append.getFieldAttr()
           << ", which is not directly below a 'dynamic' level";
  unsigned dimension = getListDimension(field);
  IndexMath math(builder, loc);
  Value list = emitListNumber(builder, loc, field, append.getIndices());
  Value at = AppendCellOp::create(builder, loc, builder.getIndexType(),
                                  emitTreeBase(builder, loc, field),
                                  field.sparse.back().node, list);
  Value zero = math.constant(0);
  Value hasCell =
      arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::sge, at, zero);
  auto branch = scf::IfOp::create(builder, loc, hasCell);
  OpBuilder inside = branch.getThenBodyBuilder();
  SmallVector<Value> indices(append.getIndices());
  IndexMath insideMath(inside, loc);
  indices.insert(
      indices.begin() + dimension,
      insideMath.add(at, insideMath.constant(field.layout.offset[dimension])));
  auto store = StoreOp::create(inside, loc, append.getValue(),
                               append.getFieldAttr(), indices);
  store->setAttr(kActiveAttrName, inside.getUnitAttr());
  // After a failed append, the launch goes on until its next test for failures.
  // Until then, the position of the append must be in range.
  append.getAt().replaceAllUsesWith(math.max(at, zero));
  append.erase();
  return success();
}

LogicalResult tai::expandAppends(FunctionOpInterface function) {
  SmallVector<AppendOp> appends;
  function->walk([&](AppendOp append) { appends.push_back(append); });
  if (appends.empty())
    return success();
  FieldTable fields(SymbolTable::getNearestSymbolTable(function));
  for (AppendOp append : appends)
    if (failed(expandAppend(append, fields)))
      return failure();
  return success();
}
