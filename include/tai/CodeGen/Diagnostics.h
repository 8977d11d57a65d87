//===- Diagnostics.h - Failures as data -------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What went wrong, in a form that can be handed to a caller in any language,
// and the collector that makes it from MLIR's diagnostics.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_DIAGNOSTICS_H
#define TAI_CODEGEN_DIAGNOSTICS_H

#include "mlir/IR/Diagnostics.h"
#include <string>
#include <vector>

namespace mlir::tai {

/// The numbers are those of `TaiStatus` in the C API.
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
  /// The first error, without its location.
  std::string message;
  /// Where it is, 1-based; empty and 0 where unknown.
  std::string file;
  int line = 0, column = 0;
  /// All diagnostics, each as "file:line:col: error: …", followed by the line
  /// of the source with a caret where the file can be read.
  std::string text;

  static Failure get(FailureKind kind, const llvm::Twine &message);
};

/// What a program does that compiles, and is hardly meant.
struct Warning {
  /// Without its location and its notes.
  std::string message;
  /// Where it is, 1-based; empty and 0 where unknown.
  std::string file;
  int line = 0, column = 0;
  /// With its notes, as `Failure::text`.
  std::string text;
};

/// Keeps, as long as it lives, the warnings that collectors of its thread meet.
/// Without one they are printed.
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

/// Prints a warning, once in a process.
void printWarning(const Warning &warning);

/// "file:line:col: kind: message", and the line of the source with a caret
/// where the file can be read.
std::string formatDiagnostic(StringRef file, unsigned line, unsigned column,
                             StringRef kind, StringRef message);

/// Collects, as long as it lives, the errors and notes that its own thread
/// emits in the context. Warnings go to the WarningScope of the thread, or are
/// printed, and remarks are handed on.
class DiagnosticCollector {
public:
  explicit DiagnosticCollector(MLIRContext *context);
  ~DiagnosticCollector();

  bool hasErrors() const { return !collected.message.empty(); }

  /// What was collected, as a failure of the given kind. Where no error was
  /// emitted the message is `otherwise`.
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
