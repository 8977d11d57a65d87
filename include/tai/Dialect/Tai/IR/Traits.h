//===- Traits.h - Traits for ops of other dialects --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Passes query these traits instead of concrete ops, so that gradient checks
// are a separate dialect, and other dialects can add similar ops.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TRAITS_H
#define TAI_DIALECT_TAI_IR_TRAITS_H

#include "mlir/IR/BuiltinAttributes.h"
#include "mlir/IR/OpDefinition.h"
#include "mlir/IR/SymbolTable.h"

namespace mlir::tai {

/// An op with a region that ends with `tai.yield`: the launches in it are
/// recorded and differentiated.
template <typename ConcreteType>
class RecordsLaunches
    : public OpTrait::TraitBase<ConcreteType, RecordsLaunches> {
public:
  static LogicalResult verifyTrait(Operation *op) {
    return OpTrait::impl::verifyOneRegion(op);
  }
};

/// An op that only reports its operands in messages, so that no derivative is
/// lost where a path of derivatives ends in the op.
template <typename ConcreteType>
class OnlyReports : public OpTrait::TraitBase<ConcreteType, OnlyReports> {};

/// For verifiers of ops that record launches: `loss` is a float field of rank 0
/// with an adjoint (tape_c1, tape_c2), and no derivative passes from one launch
/// to the next through the host (tape_c3).
LogicalResult verifyTape(Operation *tape, FlatSymbolRefAttr loss,
                         SymbolTableCollection &symbols);

} // namespace mlir::tai

#endif // TAI_DIALECT_TAI_IR_TRAITS_H
