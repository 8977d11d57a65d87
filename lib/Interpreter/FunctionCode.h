//===- FunctionCode.h - A prepared function ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_INTERPRETER_FUNCTIONCODE_H
#define TAI_LIB_INTERPRETER_FUNCTIONCODE_H

#include "Numbers.h"
#include "mlir/Interfaces/DataLayoutInterfaces.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Interpreter/Interpreter.h"
#include "llvm/ADT/DenseMap.h"

namespace mlir::tai::interpreter {

/// A field as the interpreter needs it: how to compute addresses of its
/// elements, and the sparse levels above it.
struct FieldPlace {
  FieldLayout layout;
  FieldStorage storage;
  SmallVector<SparseNode> nodes;
  unsigned tree; // its number among the trees of the module
  Type scalar;
  SmallVector<int64_t> elementShape;
};

struct Run;
/// Executes an operation. A handler that fails has reported the error to the
/// launch.
using Handler = LogicalResult (*)(Run &run, Operation *op);

/// A function to interpret, with the handlers of its operations, and the fields
/// that it uses.
class FunctionCode {
public:
  /// Makes the program of a function to interpret; null, with diagnostics, if
  /// an op of the function is not supported.
  static std::unique_ptr<FunctionCode>
  create(ModuleOp module, StringRef function,
         const InterpreterOptions &options);

  const InterpreterOptions &getOptions() const { return options; }
  FunctionOpInterface getFunction() const { return function; }
  Handler getHandler(Operation *op) const { return handlers.lookup(op); }
  ScalarFunction getScalarFunction(Operation *op) const {
    return scalarFunctions.lookup(op);
  }
  const FieldPlace &getField(StringAttr name) const {
    return *fields.find(name)->second;
  }
  /// Returns the function that a `func.call` calls.
  Operation *getCallee(Operation *call) const { return callees.lookup(call); }

private:
  LogicalResult prepare(Operation *function);
  LogicalResult prepareField(Operation *user, StringAttr name);

  InterpreterOptions options;
  ModuleOp module;
  mutable FunctionOpInterface function;
  llvm::DenseMap<Operation *, Handler> handlers;
  llvm::DenseMap<Operation *, ScalarFunction> scalarFunctions;
  llvm::DenseMap<Operation *, Operation *> callees;
  llvm::DenseMap<StringAttr, std::unique_ptr<FieldPlace>> fields;
  SmallPtrSet<Operation *, 4> prepared;
};

} // namespace mlir::tai::interpreter

#endif // TAI_LIB_INTERPRETER_FUNCTIONCODE_H
