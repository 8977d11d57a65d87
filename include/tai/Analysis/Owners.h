//===- Owners.h - Iterations that own elements ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Recognises code that `tai-choose-writers` made: stores to an element that
// only one of several iterations makes, the owner of the element.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_OWNERS_H
#define TAI_ANALYSIS_OWNERS_H

#include "mlir/Dialect/SCF/IR/SCF.h"

namespace mlir::tai {

/// True for memory that holds the numbers of the iterations that own elements:
/// an allocation of integers that stores and atomic maxima update, and that is
/// read only after the last update.
bool holdsOwners(Value memory);

/// The ops after the allocation that set the owners, in program order.
SmallVector<Operation *> findOwnerSetters(Operation *alloc);

/// The branch around `op`, below `scope`, that only the iteration which owns an
/// element takes; or null.
scf::IfOp getOwnersBranch(Operation *op, Operation *scope);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_OWNERS_H
