//===- Diagnostics.h - Failures as data -------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Errors and warnings in a form that can cross the C API, and the collector
// that makes them from MLIR's diagnostics.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_DIAGNOSTICS_H
#define TAI_CODEGEN_DIAGNOSTICS_H

#include "mlir/IR/Diagnostics.h"
#include <string>
#include <vector>

namespace mlir::tai {

/// The kinds of failures, with the numbers of `TaiStatus` in the C API.
enum class FailureKind {
  None = 0,
  Syntax = 1,
  Type = 2,
  Autodiff = 3,
  Runtime = 4,
  Memory = 5,
  Internal = 6,
  Usage = 7
};

struct Failure {
  FailureKind kind = FailureKind::None;
  /// The text of the first error, without its location.
  std::string message;
  /// The location of the first error, 1-based; empty and 0 where unknown.
  std::string file;
  int line = 0, column = 0;
  /// All diagnostics, each as "file:line:col: error: …", followed by the line
  /// of the source with a caret where the file can be read.
  std::string text;

  static Failure get(FailureKind kind, const llvm::Twine &message);
};

/// A warning of the compiler.
struct Warning {
  /// The text of the warning, without its location and notes.
  std::string message;
  /// The location of the warning, 1-based; empty and 0 where unknown.
  std::string file;
  int line = 0, column = 0;
  /// The warning with location and notes, formatted like `Failure::text`.
  std::string text;
};

/// Keeps the warnings that diagnostic collectors of the same thread receive
/// during the lifetime of the scope. Without a scope, warnings are printed.
class WarningScope {
public:
  WarningScope();
  ~WarningScope();
  WarningScope(const WarningScope &) = delete;
  WarningScope &operator=(const WarningScope &) = delete;

  std::vector<Warning> take() { return std::move(warnings); }

private:
  friend class DiagnosticCollector;
  WarningScope *outer;
  std::vector<Warning> warnings;
};

/// Prints a compiler warning to stderr, the same one at most once in a process.
void printWarning(const Warning &warning);

/// Formats a diagnostic as "file:line:col: kind: message", followed by the line
/// of the source with a caret where the file can be read.
std::string formatDiagnostic(StringRef file, unsigned line, unsigned column,
                             StringRef kind, StringRef message);

/// Collects the errors and notes that its own thread emits in the MLIR context
/// during the collector's lifetime. Warnings go to the WarningScope of the
/// thread, or are printed; remarks go to the next handler.
class DiagnosticCollector {
public:
  explicit DiagnosticCollector(MLIRContext *context);
  ~DiagnosticCollector();

  bool hasErrors() const { return !collected.message.empty(); }

  /// Takes the collected diagnostics as a failure of the given kind. The
  /// message is `otherwise` if no error was emitted.
  Failure take(FailureKind kind, const llvm::Twine &otherwise = "");

private:
  LogicalResult handle(Diagnostic &diagnostic);

  MLIRContext *context;
  DiagnosticEngine::HandlerID handler;
  uint64_t thread;
  Failure collected;
};

} // namespace mlir::tai

#endif // TAI_CODEGEN_DIAGNOSTICS_H
