//===- Printer.h - Where printed lines go -----------------------*- C++ -*-===//
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

/// Lines of kernels, each in one piece, from any thread.
class Printer {
public:
  /// Takes one whole line a call, with its newline.
  using Sink = std::function<void(std::string_view line)>;

  /// None: the standard output.
  void setSink(Sink newSink);
  void print(std::string_view line);

private:
  std::mutex mutex;
  Sink sink;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_TEXT_PRINTER_H
