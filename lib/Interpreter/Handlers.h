//===- Handlers.h - Implementations of operations ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_INTERPRETER_HANDLERS_H
#define TAI_LIB_INTERPRETER_HANDLERS_H

#include "Run.h"
#include "llvm/ADT/StringMap.h"

namespace mlir::tai::interpreter {

/// The handlers of operations, by name.
using Handlers = llvm::StringMap<Handler>;

void addControlFlowHandlers(Handlers &handlers);
void addMemoryHandlers(Handlers &handlers);
void addServiceHandlers(Handlers &handlers);
void addVectorHandlers(Handlers &handlers);

/// Applies the scalar function of an operation to each component of its
/// operands.
LogicalResult runScalars(Run &run, Operation *op);
/// Checks the preconditions of a function; fails the launch if a precondition
/// does not hold.
LogicalResult checkPreconditions(Run &run, Block &body);

} // namespace mlir::tai::interpreter

#endif // TAI_LIB_INTERPRETER_HANDLERS_H
