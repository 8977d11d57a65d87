//===- TaiStackOps.cpp - Stacks of values ---------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/PatternMatch.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

LogicalResult StackCreateOp::verify() {
  Type type = cast<StackType>(getStack().getType()).getElementType();
  if (type.isIndex() ||
      (type.isIntOrFloat() && type.getIntOrFloatBitWidth() <= 64))
    return success();
  return emitOpError("expects a scalar of at most 64 bits, but got ") << type;
}

LogicalResult StackCreateOp::canonicalize(StackCreateOp op,
                                          PatternRewriter &rewriter) {
  // A stack that nobody pops from.
  for (Operation *user : op->getUsers())
    if (!isa<StackPushOp, StackDestroyOp>(user))
      return failure();
  for (Operation *user : llvm::make_early_inc_range(op->getUsers()))
    rewriter.eraseOp(user);
  rewriter.eraseOp(op);
  return success();
}
