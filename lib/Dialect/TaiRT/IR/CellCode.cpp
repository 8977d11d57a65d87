//===- CellCode.cpp - Emits queries and changes of activity ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The default implementations of SNodeTypeInterface: tests of activity read a
// bit or a length inline; all changes are calls of the runtime.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"

using namespace mlir;
using namespace mlir::tai;

static Value emitConstant(OpBuilder &builder, Location loc, int64_t value) {
  return arith::ConstantIndexOp::create(builder, loc, value);
}
static Value emitQuotient(OpBuilder &builder, Location loc, Value a,
                          int64_t b) {
  return builder.createOrFold<arith::DivUIOp>(loc, a,
                                              emitConstant(builder, loc, b));
}
static Value emitRemainder(OpBuilder &builder, Location loc, Value a,
                           int64_t b) {
  return builder.createOrFold<arith::RemUIOp>(loc, a,
                                              emitConstant(builder, loc, b));
}

/// Emits an atomic load of element `number` of an array in the tree to which
/// other threads may write.
static Value emitAtomicLoad(OpBuilder &builder, Location loc, Type type,
                            const CellRef &cell, Value number) {
  unsigned bytes = type.getIntOrFloatBitWidth() / 8;
  auto flags = arith::IntegerOverflowFlagsAttr::get(
      builder.getContext(), arith::IntegerOverflowFlags::nsw);
  Value position = builder.createOrFold<arith::MulIOp>(
      loc, number, emitConstant(builder, loc, bytes), flags);
  position = builder.createOrFold<arith::AddIOp>(
      loc, position, emitConstant(builder, loc, cell.activityOffset), flags);
  position = builder.createOrFold<arith::IndexCastOp>(loc, builder.getI64Type(),
                                                      position);
  Value pointer = LLVM::GEPOp::create(
      builder, loc, LLVM::LLVMPointerType::get(builder.getContext()),
      builder.getI8Type(), cell.tree, ArrayRef<LLVM::GEPArg>{position},
      LLVM::GEPNoWrapFlags::inbounds | LLVM::GEPNoWrapFlags::nuw);
  return LLVM::LoadOp::create(builder, loc, type, pointer, /*alignment=*/bytes,
                              /*isVolatile=*/false, /*isNonTemporal=*/false,
                              /*isInvariant=*/false,
                              /*isInvariantGroup=*/false,
                              LLVM::AtomicOrdering::monotonic);
}

Value tai::emitListLength(OpBuilder &builder, Location loc, const CellRef &at,
                          Value list) {
  Value length = emitAtomicLoad(builder, loc, builder.getI32Type(), at, list);
  return arith::IndexCastOp::create(builder, loc, builder.getIndexType(),
                                    length);
}

Value tai::emitIsActive(OpBuilder &builder, Location loc, CellActivity activity,
                        const CellRef &cell) {
  switch (activity) {
  case CellActivity::All:
    return arith::ConstantIntOp::create(builder, loc, 1, 1);
  case CellActivity::Length: {
    Value length =
        emitListLength(builder, loc, cell,
                       emitQuotient(builder, loc, cell.cell, cell.capacity));
    return arith::CmpIOp::create(
        builder, loc, arith::CmpIPredicate::slt,
        emitRemainder(builder, loc, cell.cell, cell.capacity), length);
  }
  case CellActivity::Bits:
    break;
  }
  Type i64 = builder.getI64Type();
  Value word = emitAtomicLoad(builder, loc, i64, cell,
                              emitQuotient(builder, loc, cell.cell, 64));
  Value position = builder.createOrFold<arith::IndexCastOp>(
      loc, i64, emitRemainder(builder, loc, cell.cell, 64));
  Value bit = arith::ShRUIOp::create(builder, loc, word, position);
  return arith::TruncIOp::create(builder, loc, builder.getI1Type(), bit);
}

Value tai::emitActivate(OpBuilder &builder, Location loc, const CellRef &cell) {
  return ActivateCellOp::create(builder, loc, builder.getI1Type(), cell.tree,
                                cell.node, cell.cell);
}

void tai::emitDeactivate(OpBuilder &builder, Location loc,
                         const CellRef &cell) {
  DeactivateCellOp::create(builder, loc, cell.tree, cell.node, cell.cell);
}

CellList tai::emitActiveCells(OpBuilder &builder, Location loc, Value tree,
                              unsigned node) {
  auto cells = ActiveCellsOp::create(builder, loc, tree, node);
  return {cells.getCells(), cells.getCount()};
}
