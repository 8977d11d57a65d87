//===- TaiDialect.cpp - Registration of the dialect -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Registers what the dialect defines, and lets helper functions be inlined
// into kernels.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Transforms/InliningUtils.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

#include "tai/Dialect/Tai/IR/TaiDialect.cpp.inc"

namespace {
/// Any op of the dialect may be inlined: kernels call helpers, nothing calls a
/// kernel.
struct TaiInlinerInterface : DialectInlinerInterface {
  using DialectInlinerInterface::DialectInlinerInterface;

  bool isLegalToInline(Operation *, Operation *, bool) const final {
    return true;
  }
  bool isLegalToInline(Region *, Region *, bool, IRMapping &) const final {
    return true;
  }
  bool isLegalToInline(Operation *, Region *, bool, IRMapping &) const final {
    return true;
  }
};
} // namespace

void TaiDialect::initialize() {
  registerTypes();
  registerAttributes();
  registerOps();
  addInterfaces<TaiInlinerInterface>();
}
