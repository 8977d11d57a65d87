//===- InjectedFailures.h - Failures injected by tests ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Makes the compiler fail on purpose, to test how internal errors are reported.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_INJECTEDFAILURES_H
#define TAI_CODEGEN_INJECTEDFAILURES_H

#include "llvm/ADT/StringRef.h"
#include <cstdlib>

namespace mlir {
class OpPassManager;
} // namespace mlir

namespace mlir::tai {

/// True where the environment variable TAI_INJECT_FAILURE names this place.
inline bool injectsFailure(llvm::StringRef place) {
  const char *given = std::getenv("TAI_INJECT_FAILURE");
  return given && place == given;
}

/// Adds a pass that fails if TAI_INJECT_FAILURE is `place` (without a
/// diagnostic) or `place` followed by "-invalid" (by leaving invalid IR).
void injectFailingPass(OpPassManager &manager, llvm::StringRef place);

} // namespace mlir::tai

#endif // TAI_CODEGEN_INJECTEDFAILURES_H
