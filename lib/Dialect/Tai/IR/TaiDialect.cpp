//===- TaiDialect.cpp - Registration of the dialect -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Registers the parts of the dialect, and lets helper functions be inlined
// into kernels. Types register themselves in TaiTypes.cpp, next to their
// storage.
//
//===----------------------------------------------------------------------===//

#include "DiscardableAttrs.h"
#include "OpModels.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/IR/Builders.h"
#include "mlir/IR/DialectImplementation.h"
#include "mlir/Transforms/InliningUtils.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Dialect/Tai/IR/TreeLayout.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

#include "tai/Dialect/Tai/IR/TaiDialect.cpp.inc"
#include "tai/Dialect/Tai/IR/TaiEnums.cpp.inc"
#define GET_ATTRDEF_CLASSES
#include "tai/Dialect/Tai/IR/TaiAttrs.cpp.inc"

namespace {
/// Any op of the dialect may be inlined: kernels call helpers, and no code
/// calls a kernel.
struct TaiInlinerInterface : DialectInlinerInterface {
  using DialectInlinerInterface::DialectInlinerInterface;

  bool isLegalToInline(Operation *, Operation *, bool) const final {
    return true;
  }
  /// The regions of kernels, loops and tapes must have one block.
  bool isLegalToInline(Region *, Region *source, bool,
                       IRMapping &) const final {
    return source->hasOneBlock();
  }
  bool isLegalToInline(Operation *, Region *, bool, IRMapping &) const final {
    return true;
  }
};
} // namespace

void TaiDialect::registerAttributes() {
  addAttributes<
#define GET_ATTRDEF_LIST
#include "tai/Dialect/Tai/IR/TaiAttrs.cpp.inc"
      >();
}

void TaiDialect::registerOps() {
  addOperations<
#define GET_OP_LIST
#include "tai/Dialect/Tai/IR/TaiOps.cpp.inc"
      >();
}

void TaiDialect::initialize() {
  registerTypes();
  registerAttributes();
  registerOps();
  addInterfaces<TaiInlinerInterface, PlaceIndex>();
  attachMemoryModels(*getContext());
  attachAsmNames(*getContext());
  addMarkerFolds(*this);
}

Operation *TaiDialect::materializeConstant(OpBuilder &builder, Attribute value,
                                           Type type, Location loc) {
  return arith::ConstantOp::materialize(builder, value, type, loc);
}

LogicalResult TaiDialect::verifyOperationAttribute(Operation *op,
                                                   NamedAttribute attribute) {
  return verifyDiscardableAttr(op, attribute);
}

LogicalResult TaiDialect::verifyRegionArgAttribute(Operation *op, unsigned,
                                                   unsigned index,
                                                   NamedAttribute attribute) {
  return verifyArgumentAttr(op, index, attribute);
}

LogicalResult
TaiDialect::verifyRegionResultAttribute(Operation *op, unsigned, unsigned index,
                                        NamedAttribute attribute) {
  return verifyResultAttr(op, index, attribute);
}
