//===- CodegenErrors.h - Errors inside LLVM ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// LLVM reports some errors to a handler of the context, and for others its code
// generator ends the process. A compiler inside a user's process must turn both
// kinds into llvm::Error.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_CODEGENERRORS_H
#define TAI_LIB_CODEGEN_CODEGENERRORS_H

#include "llvm/ADT/STLFunctionalExtras.h"
#include "llvm/IR/DiagnosticHandler.h"
#include "llvm/Support/Error.h"
#include <string>

namespace mlir::tai {

/// Runs `task`, in which LLVM can meet a fatal error. If it does, `broken`
/// becomes true, and the objects that the task worked on must be neither used
/// nor destroyed. `place` names this point for failures that tests inject
/// (InjectedFailures.h).
llvm::Error guardFatalErrors(bool &broken, llvm::StringRef place,
                             llvm::function_ref<void()> task);

/// A diagnostic handler that keeps the first error that code generation
/// reports.
struct CodegenErrors : llvm::DiagnosticHandler {
  explicit CodegenErrors(std::string &message) : message(message) {}

  bool handleDiagnostics(const llvm::DiagnosticInfo &info) override;

  std::string &message;
};

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_CODEGENERRORS_H
