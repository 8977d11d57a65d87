//===- Owners.h - Iterations that own elements ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The traces of `tai-choose-writers`: stores that only one of several
// iterations makes, the owner of the element.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_OWNERS_H
#define TAI_ANALYSIS_OWNERS_H

#include "mlir/Dialect/SCF/IR/SCF.h"

namespace mlir::tai {

/// True for memory that holds the numbers of the iterations that own elements:
/// an allocation of integers, of which the greatest ones are found, and then
/// read.
bool holdsOwners(Value memory);

/// The ops behind an allocation of owners that set them, in their order.
SmallVector<Operation *> findOwnerSetters(Operation *alloc);

/// The branch around `op`, below `scope`, that only the owner of an element
/// takes; or null.
scf::IfOp getOwnersBranch(Operation *op, Operation *scope);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_OWNERS_H
