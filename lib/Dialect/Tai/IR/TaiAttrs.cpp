//===- TaiAttrs.cpp - Attributes of the dialect ---------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/Builders.h"
#include "mlir/IR/DialectImplementation.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

#include "tai/Dialect/Tai/IR/TaiEnums.cpp.inc"
#define GET_ATTRDEF_CLASSES
#include "tai/Dialect/Tai/IR/TaiAttrs.cpp.inc"

void TaiDialect::registerAttributes() {
  addAttributes<
#define GET_ATTRDEF_LIST
#include "tai/Dialect/Tai/IR/TaiAttrs.cpp.inc"
      >();
}
