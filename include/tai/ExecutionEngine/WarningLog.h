//===- WarningLog.h - Warnings of a session ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What the compiler says of kernels that it compiles, or finds in the cache.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_WARNINGLOG_H
#define TAI_EXECUTIONENGINE_WARNINGLOG_H

#include "mlir/Support/LLVM.h"
#include "tai/CodeGen/Diagnostics.h"
#include "llvm/ADT/StringSet.h"
#include <functional>
#include <mutex>

namespace mlir::tai {

/// Any thread may call any of it.
class WarningLog {
public:
  /// `isOfGradient`: of an adjoint, or of what carries tangents.
  using Handler = std::function<void(const Warning &, bool isOfGradient)>;

  /// Null to print them.
  void setHandler(Handler handler);

  /// Tells those that have not been told yet: a kernel is compiled again for
  /// each of its forms.
  void tell(ArrayRef<Warning> warnings, bool isOfGradient);

private:
  std::mutex mutex;
  Handler handler;
  llvm::StringSet<> told;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_WARNINGLOG_H
