//===- TaiRTDialect.cpp - The level below the front dialect ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/Builders.h"
#include "mlir/IR/DialectImplementation.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"

using namespace mlir;
using namespace mlir::tai;

#include "tai/Dialect/TaiRT/IR/TaiRTDialect.cpp.inc"

#define GET_OP_CLASSES
#include "tai/Dialect/TaiRT/IR/TaiRTOps.cpp.inc"

void TaiRTDialect::initialize() {
  addOperations<
#define GET_OP_LIST
#include "tai/Dialect/TaiRT/IR/TaiRTOps.cpp.inc"
      >();
}

LogicalResult TreeBaseOp::verifySymbolUses(SymbolTableCollection &symbols) {
  if (symbols.lookupNearestSymbolFrom<TreeOp>(*this, getTreeAttr()))
    return success();
  return emitOpError() << "names '" << getTreeAttr()
                       << "', which is not a tree";
}
