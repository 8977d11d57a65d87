//===- WarningLog.h - Warnings of a session ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Warnings about kernels that were compiled, or loaded from the cache.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_REPORTS_WARNINGLOG_H
#define TAI_EXECUTIONENGINE_REPORTS_WARNINGLOG_H

#include "mlir/Support/LLVM.h"
#include "tai/CodeGen/Diagnostics.h"
#include "llvm/ADT/StringSet.h"
#include <functional>
#include <mutex>

namespace mlir::tai {

/// Thread-safe.
class WarningLog {
public:
  /// Receives warnings. `isOfGradient` is true for a warning about an adjoint
  /// or a forward-mode variant.
  using Handler = std::function<void(const Warning &, bool isOfGradient)>;

  /// Sets the function that receives warnings. A null handler prints warnings.
  void setHandler(Handler handler);

  /// Reports those of the given warnings that have not been reported yet. A
  /// kernel is compiled once for each of its variants, which would repeat
  /// warnings.
  void tell(ArrayRef<Warning> warnings, bool isOfGradient);

private:
  std::mutex mutex;
  Handler handler;
  llvm::StringSet<> told;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_REPORTS_WARNINGLOG_H
