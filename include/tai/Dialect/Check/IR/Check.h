//===- Check.h - Programs that check themselves -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `tai_check.close` and `tai_check.gradient`, and support for programs that use
// their former names.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_CHECK_IR_CHECK_H
#define TAI_DIALECT_CHECK_IR_CHECK_H

#include "mlir/Bytecode/BytecodeOpInterface.h"
#include "mlir/IR/BuiltinAttributes.h"
#include "mlir/IR/BuiltinTypes.h"
#include "mlir/IR/Dialect.h"
#include "mlir/IR/OpDefinition.h"
#include "mlir/IR/OpImplementation.h"
#include "mlir/IR/SymbolTable.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// Registers the check dialect, and makes the tai dialect load it: a program
/// that uses the former names mentions the tai dialect only.
void registerCheckDialect(DialectRegistry &registry);

/// Replaces check ops in `root` that use former op names by the present ops.
void upgradeFormerChecks(Operation *root);

} // namespace mlir::tai

#include "tai/Dialect/Check/IR/CheckDialect.h.inc"

#define GET_OP_CLASSES
#include "tai/Dialect/Check/IR/CheckOps.h.inc"

#endif // TAI_DIALECT_CHECK_IR_CHECK_H
