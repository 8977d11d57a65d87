//===- SilencedDiagnostics.h - Attempts that may fail -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Drops the diagnostics of the current thread during the lifetime of the
// object. Handlers belong to the context, in which other threads compile as
// well: a handler that dropped all diagnostics would lose the errors of other
// threads.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_SUPPORT_SILENCEDDIAGNOSTICS_H
#define TAI_SUPPORT_SILENCEDDIAGNOSTICS_H

#include "mlir/IR/Diagnostics.h"
#include "llvm/Support/Threading.h"

namespace mlir::tai {

class SilencedDiagnostics : public ScopedDiagnosticHandler {
public:
  explicit SilencedDiagnostics(MLIRContext *context)
      : ScopedDiagnosticHandler(context) {
    setHandler([thread = llvm::get_threadid()](Diagnostic &) {
      return success(llvm::get_threadid() == thread);
    });
  }
};

} // namespace mlir::tai

#endif // TAI_SUPPORT_SILENCEDDIAGNOSTICS_H
