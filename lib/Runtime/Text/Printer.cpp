//===- Printer.cpp - Output of kernels ------------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Text/Printer.h"
#include <cstdio>

using namespace mlir::tai::runtime;

void Printer::setSink(Sink newSink) {
  std::lock_guard<std::mutex> lock(mutex);
  sink = std::move(newSink);
}

void Printer::print(std::string_view line) {
  std::lock_guard<std::mutex> lock(mutex);
  if (sink) {
    sink(line);
    return;
  }
  std::fwrite(line.data(), 1, line.size(), stdout);
  std::fflush(stdout);
}
