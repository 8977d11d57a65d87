//===- VerifyEach.h - Verifiers after each step of a test -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// With TAI_VERIFY_EACH=1, as tests set it, MLIR's verifier runs after each pass
// of the compiler, and LLVM's after translation, after each LLVM pass of ours
// and in front of code generation. It costs time that programs of users do not
// spend.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_VERIFYEACH_H
#define TAI_LIB_CODEGEN_VERIFYEACH_H

namespace llvm {
class PassInstrumentationCallbacks;
} // namespace llvm

namespace mlir::tai {

/// Whether the environment asks for it.
bool verifiesEach();

/// Runs LLVM's verifier after each pass of ours, if it is asked for. What is
/// not valid then is a fatal error of LLVM's; see guardFatalErrors.
void verifyOwnPasses(llvm::PassInstrumentationCallbacks &callbacks);

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_VERIFYEACH_H
