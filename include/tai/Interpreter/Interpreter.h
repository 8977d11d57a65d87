//===- Interpreter.h - Kernels run without a compiler -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Runs a function as it stands, operation by operation, and in no hurry: what
// compiled code does can be compared with what the program says. It shares with
// compiled code the interface to the runtime (Abi.h) and where a place lies in
// its tree (Layout.h), and no pass.
//
// Numbers are those of the type of each operation, rounded once an operation.
// What an operation leaves undefined (a shift by more bits than there are, a
// float that no integer stands for, an index out of range) fails the launch,
// with the place.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_INTERPRETER_INTERPRETER_H
#define TAI_INTERPRETER_INTERPRETER_H

#include "mlir/IR/BuiltinOps.h"
#include "mlir/IR/OwningOpRef.h"
#include "tai/ABI/Abi.h"
#include <memory>

namespace mlir::tai {

struct InterpreterOptions {
  /// Assertions are checked, and divisions by zero reported.
  bool debug = false;
  /// If not zero, iterations of parallel loops run in an order drawn from it,
  /// and in ascending order else.
  uint64_t orderSeed = 0;
};

namespace interpreter {
class Program;
} // namespace interpreter

/// A kernel or a host function (`func.func`) with what it calls.
class Interpreter {
public:
  ~Interpreter();

  /// Takes a module as the compiler gets it. Operations that the interpreter
  /// does not know are errors, reported where they stand.
  static std::shared_ptr<const Interpreter>
  create(OwningOpRef<ModuleOp> module, StringRef function,
         const InterpreterOptions &options);

  /// Does what a TaiKernelFn does. Several threads may run it at once.
  int32_t run(TaiFrame *frame) const;

private:
  Interpreter() = default;

  OwningOpRef<ModuleOp> module;
  std::unique_ptr<interpreter::Program> program;
};

} // namespace mlir::tai

#endif // TAI_INTERPRETER_INTERPRETER_H
