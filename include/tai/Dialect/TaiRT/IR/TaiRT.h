//===- TaiRT.h - The dialect below tai --------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Ops for addresses of trees and cells of sparse levels. Sparse levels build
// these ops with helpers that are declared in Layout.h and Tai.h, and defined
// in this library, in CellCode.cpp.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAIRT_IR_TAIRT_H
#define TAI_DIALECT_TAIRT_IR_TAIRT_H

#include "mlir/Bytecode/BytecodeOpInterface.h"
#include "mlir/Dialect/LLVMIR/LLVMTypes.h"
#include "mlir/IR/BuiltinAttributes.h"
#include "mlir/IR/BuiltinTypes.h"
#include "mlir/IR/Dialect.h"
#include "mlir/IR/OpDefinition.h"
#include "mlir/IR/OpImplementation.h"
#include "mlir/IR/SymbolTable.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"

#include "tai/Dialect/TaiRT/IR/TaiRTDialect.h.inc"

#define GET_OP_CLASSES
#include "tai/Dialect/TaiRT/IR/TaiRTOps.h.inc"

#endif // TAI_DIALECT_TAIRT_IR_TAIRT_H
