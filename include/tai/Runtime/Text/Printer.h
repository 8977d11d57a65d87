//===- Printer.h - Output of kernels ----------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_TEXT_PRINTER_H
#define TAI_RUNTIME_TEXT_PRINTER_H

#include <functional>
#include <mutex>
#include <string_view>

namespace mlir::tai::runtime {

/// Prints lines of kernels atomically. Thread-safe.
class Printer {
public:
  /// The type of the receiver of printed text. It is called with one complete
  /// line, including its newline, or with the part of a line that a print
  /// without a newline gives.
  using Sink = std::function<void(std::string_view line)>;

  /// Sets the receiver of printed lines; an empty function means standard
  /// output.
  void setSink(Sink newSink);
  void print(std::string_view line);

private:
  std::mutex mutex;
  Sink sink;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_TEXT_PRINTER_H
