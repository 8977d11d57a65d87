//===- Preconditions.cpp - Launches that are refused ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A launch tests once whether all preconditions hold. A separate block, off the
// fast path, determines the one that fails, and its message.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Conversion/TaiToHost/Lowering.h"
#include "tai/Support/BoundsMode.h"

using namespace mlir;
using namespace mlir::tai;

void tai::lowerPreconditions(LLVM::LLVMFuncOp function,
                             ModuleLowering &lowering) {
  Block *entry = &function.getBody().front();
  auto preconditions = llvm::to_vector(entry->getOps<PreconditionOp>());
  if (preconditions.empty())
    return;
  Location loc = function.getLoc();
  RuntimeCalls &runtime = lowering.runtime;
  OpBuilder builder(function.getContext());
  builder.setInsertionPointAfter(preconditions.back());
  Value all;
  for (PreconditionOp op : preconditions) {
    Value holds = op.getCondition();
    all = all ? arith::AndIOp::create(builder, loc, all, holds).getResult()
              : holds;
  }
  Block *body = entry->splitBlock(builder.getInsertionPoint());
  Block *refused = builder.createBlock(&function.getBody());
  builder.setInsertionPointToEnd(entry);
  auto branch = LLVM::CondBrOp::create(builder, loc, all, body, ValueRange(),
                                       refused, ValueRange());
  branch.setBranchWeights(ArrayRef<int32_t>{1 << 20, 1});

  builder.setInsertionPointToEnd(refused);
  Value yes = arith::ConstantIntOp::create(builder, loc, 1, 1);
  for (PreconditionOp op : preconditions) {
    Value broken =
        arith::XOrIOp::create(builder, op.getLoc(), op.getCondition(), yes);
    auto report = scf::IfOp::create(builder, op.getLoc(), broken);
    OpBuilder inside = report.getThenBodyBuilder();
    emitFail(runtime, inside, op.getLoc(), entry->getArgument(0),
             TAI_FAIL_INDEX, op.getMessage(), op.getArgs(), {});
  }
  LLVM::ReturnOp::create(builder, loc, runtime.i32(builder, loc, 1));
  for (PreconditionOp op : preconditions)
    op.erase();
}
