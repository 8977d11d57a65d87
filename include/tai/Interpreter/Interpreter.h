//===- Interpreter.h - Executes IR without compiling it ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Executes a function operation by operation, before any pass, as a reference
// for compiled code. It shares with compiled code only the interface to the
// runtime (Abi.h) and the addresses of places (Layout.h).
//
// Each operation computes in its type, and rounds once. Undefined behaviour of
// an operation (a shift by too many bits, a float outside of the integer range,
// an index out of range) fails the launch with its location.
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
  /// True if assertions are checked and divisions by zero reported.
  bool debug = false;
  /// If non-zero, the seed of a random order of iterations of parallel loops;
  /// otherwise they run in ascending order.
  uint64_t orderSeed = 0;
};

namespace interpreter {
class FunctionCode;
} // namespace interpreter

/// Interprets a kernel or a host function (`func.func`) with all functions that
/// it calls.
class Interpreter {
public:
  ~Interpreter();

  /// Creates an interpreter of `function` in `module`, the same module as the
  /// compiler gets. Emits an error and returns null at an op that the
  /// interpreter does not support.
  static std::shared_ptr<const Interpreter>
  create(OwningOpRef<ModuleOp> module, StringRef function,
         const InterpreterOptions &options);

  /// Runs the function on the arguments in `frame`, like a compiled
  /// TaiKernelFn. Thread-safe.
  int32_t run(TaiFrame *frame) const;

private:
  Interpreter() = default;

  OwningOpRef<ModuleOp> module;
  std::unique_ptr<interpreter::FunctionCode> program;
};

} // namespace mlir::tai

#endif // TAI_INTERPRETER_INTERPRETER_H
