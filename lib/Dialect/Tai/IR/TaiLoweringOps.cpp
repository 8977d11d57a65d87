//===- TaiLoweringOps.cpp - What stands between kernels and LLVM ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

LogicalResult TreeBaseOp::verifySymbolUses(SymbolTableCollection &symbols) {
  if (symbols.lookupNearestSymbolFrom<TreeOp>(*this, getTreeAttr()))
    return success();
  return emitOpError() << "names '" << getTreeAttr()
                       << "', which is not a tree";
}
