//===- VerifyEach.h - Verifiers after each step -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// With TAI_VERIFY_EACH=1, as tests set it, MLIR's verifier runs after each pass
// of the compiler, and LLVM's after translation, after each of tai's LLVM
// passes and before code generation. Off by default, because it takes time.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_VERIFYEACH_H
#define TAI_CODEGEN_VERIFYEACH_H

namespace llvm {
class PassInstrumentationCallbacks;
} // namespace llvm

namespace mlir::tai {

/// Whether TAI_VERIFY_EACH=1 is set.
bool verifiesEach();

/// Runs LLVM's verifier after each of tai's LLVM passes, if TAI_VERIFY_EACH=1.
/// Invalid IR is a fatal error of LLVM; see guardFatalErrors.
void verifyOwnPasses(llvm::PassInstrumentationCallbacks &callbacks);

} // namespace mlir::tai

#endif // TAI_CODEGEN_VERIFYEACH_H
