//===- DiscardableAttrs.h - Attributes of other ops -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_DIALECT_TAI_IR_DISCARDABLEATTRS_H
#define TAI_LIB_DIALECT_TAI_IR_DISCARDABLEATTRS_H

#include "mlir/IR/Operation.h"

namespace mlir::tai {

/// An inherent attribute of kernels and the name that it had when it was
/// discardable.
struct RenamedAttr {
  llvm::StringLiteral old, name;
};
/// Lists former names of attributes that users may have written. The parser of
/// kernels maps an old name to the new name; elsewhere, the verifier rejects
/// it.
llvm::ArrayRef<RenamedAttr> getRenamedKernelAttrs();

/// Verifies a discardable attribute `tai.*` on an op of any dialect.
LogicalResult verifyDiscardableAttr(Operation *op, NamedAttribute attribute);
/// Verify a discardable attribute `tai.*` of an argument, or of a result, of a
/// function.
LogicalResult verifyArgumentAttr(Operation *op, unsigned index,
                                 NamedAttribute attribute);
LogicalResult verifyResultAttr(Operation *op, unsigned index,
                               NamedAttribute attribute);

} // namespace mlir::tai

#endif // TAI_LIB_DIALECT_TAI_IR_DISCARDABLEATTRS_H
