//===- MarkerFolds.cpp - Folds of ops that mark values --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `tai.stop_gradient` and `tai.derive_as` return a value as it is, and tell
// differentiation something about it that may be known already.
//
//===----------------------------------------------------------------------===//

#include "OpModels.h"
#include "mlir/Interfaces/FoldInterfaces.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

/// The value that `op` can be replaced by, or null.
static Value foldMarker(Operation *op, ArrayRef<Attribute> operands) {
  return llvm::TypeSwitch<Operation *, Value>(op)
      .Case([&](StopGradientOp stop) -> Value {
        // A marker is redundant on a constant, or on a value that has passed a
        // marker, since neither has a derivative.
        if (operands[0] || stop.getValue().getDefiningOp<StopGradientOp>())
          return stop.getValue();
        return {};
      })
      .Case([](DeriveAsOp derive) -> Value {
        return derive.getValue() == derive.getForm() ? derive.getValue()
                                                     : Value();
      })
      .Default(Value());
}

namespace {
struct MarkerFolds : DialectFoldInterface {
  using DialectFoldInterface::DialectFoldInterface;

  LogicalResult fold(Operation *op, ArrayRef<Attribute> operands,
                     SmallVectorImpl<OpFoldResult> &results) const final {
    Value value = foldMarker(op, operands);
    if (!value)
      return failure();
    results.push_back(value);
    return success();
  }
};
} // namespace

void tai::addMarkerFolds(TaiDialect &dialect) {
  dialect.addInterfaces<MarkerFolds>();
}
