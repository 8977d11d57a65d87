//===- WarningLog.cpp - Warnings of a session -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Reports/WarningLog.h"

using namespace mlir;
using namespace mlir::tai;

void WarningLog::setHandler(Handler given) {
  std::lock_guard<std::mutex> lock(mutex);
  handler = std::move(given);
}

void WarningLog::tell(ArrayRef<Warning> warnings, bool isOfGradient) {
  std::lock_guard<std::mutex> lock(mutex);
  for (const Warning &warning : warnings) {
    if (!told.insert(warning.text).second)
      continue;
    if (handler)
      handler(warning, isOfGradient);
    else
      printWarning(warning);
  }
}
