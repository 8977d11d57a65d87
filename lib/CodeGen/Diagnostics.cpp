//===- Diagnostics.cpp - Failures as data ---------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Diagnostics.h"
#include "mlir/IR/BuiltinAttributes.h"
#include "tai/Support/Places.h"
#include "llvm/ADT/StringSet.h"
#include "llvm/Support/LineIterator.h"
#include "llvm/Support/ManagedStatic.h"
#include "llvm/Support/MemoryBuffer.h"
#include "llvm/Support/Threading.h"
#include "llvm/Support/raw_ostream.h"
#include <mutex>

using namespace mlir;
using namespace mlir::tai;

Failure Failure::get(FailureKind kind, const llvm::Twine &message) {
  Failure failure;
  failure.kind = kind;
  failure.message = message.str();
  failure.text = "error: " + failure.message + "\n";
  return failure;
}

/// Appends the line of the source, and a caret below the column.
static void appendSourceLine(std::string &text, StringRef file, unsigned number,
                             unsigned column) {
  auto buffer = llvm::MemoryBuffer::getFile(file);
  if (!buffer || number == 0)
    return;
  llvm::line_iterator lines(**buffer, /*SkipBlanks=*/false);
  while (!lines.is_at_eof() && lines.line_number() < number)
    ++lines;
  if (lines.is_at_eof())
    return;
  StringRef line = *lines;
  text += (line + "\n").str();
  if (column == 0 || column > line.size() + 1)
    return;
  // Tabs of the source line are copied, so that the caret is below its column.
  for (char c : line.take_front(column - 1))
    text += c == '\t' ? '\t' : ' ';
  text += "^\n";
}

std::string mlir::tai::formatDiagnostic(StringRef file, unsigned line,
                                        unsigned column, StringRef kind,
                                        StringRef message) {
  std::string text;
  llvm::raw_string_ostream stream(text);
  if (!file.empty())
    stream << file << ':' << line << ':' << column << ": ";
  stream << kind << ": " << message << '\n';
  if (!file.empty())
    appendSourceLine(text, file, line, column);
  return text;
}

static std::string formatAt(FileLineColLoc place, StringRef kind,
                            StringRef message) {
  if (!place)
    return formatDiagnostic("", 0, 0, kind, message);
  return formatDiagnostic(place.getFilename(), place.getLine(),
                          place.getColumn(), kind, message);
}

static void appendDiagnostic(std::string &text, Location location,
                             StringRef kind, StringRef message) {
  text += formatAt(findFileLocation(location), kind, message);
  // If the code was inlined, the diagnostic also says where the function was
  // called.
  location->walk([&](Location inner) {
    if (auto call = dyn_cast<CallSiteLoc>(inner))
      if (FileLineColLoc caller = findFileLocation(call.getCaller()))
        text += formatAt(caller, "note", "called from here");
    return WalkResult::advance();
  });
}

DiagnosticCollector::DiagnosticCollector(MLIRContext *context)
    : context(context), thread(llvm::get_threadid()) {
  handler = context->getDiagEngine().registerHandler(
      [this](Diagnostic &diagnostic) { return handle(diagnostic); });
}

DiagnosticCollector::~DiagnosticCollector() {
  context->getDiagEngine().eraseHandler(handler);
}

//===----------------------------------------------------------------------===//
// Warnings
//===----------------------------------------------------------------------===//

static thread_local WarningScope *warningScope = nullptr;

WarningScope::WarningScope() : outer(warningScope) { warningScope = this; }

WarningScope::~WarningScope() { warningScope = outer; }

static Warning makeWarning(Diagnostic &diagnostic) {
  Warning warning;
  warning.message = diagnostic.str();
  if (FileLineColLoc place = findFileLocation(diagnostic.getLocation())) {
    warning.file = place.getFilename().str();
    warning.line = place.getLine();
    warning.column = place.getColumn();
  }
  appendDiagnostic(warning.text, diagnostic.getLocation(), "warning",
                   warning.message);
  for (Diagnostic &note : diagnostic.getNotes())
    appendDiagnostic(warning.text, note.getLocation(), "note", note.str());
  return warning;
}

void mlir::tai::printWarning(const Warning &warning) {
  static llvm::ManagedStatic<std::mutex> mutex;
  static llvm::ManagedStatic<llvm::StringSet<>> printed;
  std::lock_guard<std::mutex> lock(*mutex);
  if (printed->insert(warning.text).second)
    std::fprintf(stderr, "%s\n", warning.text.c_str());
}

//===----------------------------------------------------------------------===//
// Errors
//===----------------------------------------------------------------------===//

LogicalResult DiagnosticCollector::handle(Diagnostic &diagnostic) {
  // Diagnostics of other threads that compile in the same context are ignored.
  if (llvm::get_threadid() != thread)
    return failure();
  if (diagnostic.getSeverity() == DiagnosticSeverity::Warning) {
    Warning warning = makeWarning(diagnostic);
    if (warningScope)
      warningScope->warnings.push_back(std::move(warning));
    else
      printWarning(warning);
    return success();
  }
  if (diagnostic.getSeverity() != DiagnosticSeverity::Error)
    return failure();
  std::string message = diagnostic.str();
  if (!hasErrors()) {
    collected.message = message.empty() ? "unknown error" : message;
    if (FileLineColLoc place = findFileLocation(diagnostic.getLocation())) {
      collected.file = place.getFilename().str();
      collected.line = place.getLine();
      collected.column = place.getColumn();
    }
  }
  appendDiagnostic(collected.text, diagnostic.getLocation(), "error", message);
  for (Diagnostic &note : diagnostic.getNotes())
    appendDiagnostic(collected.text, note.getLocation(), "note", note.str());
  return success();
}

Failure DiagnosticCollector::take(FailureKind kind,
                                  const llvm::Twine &otherwise) {
  if (!hasErrors())
    return Failure::get(kind, otherwise);
  Failure taken = std::move(collected);
  collected = Failure();
  taken.kind = kind;
  return taken;
}
