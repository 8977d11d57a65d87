//===- VerifyEach.cpp - Verifiers after each step -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/VerifyEach.h"
#include "llvm/ADT/STLExtras.h"
#include "llvm/IR/Function.h"
#include "llvm/IR/PassInstrumentation.h"
#include "llvm/IR/Verifier.h"
#include "llvm/Support/ErrorHandling.h"
#include "llvm/Support/raw_ostream.h"
#include <cstdlib>

using namespace llvm;

bool mlir::tai::verifiesEach() {
  const char *given = std::getenv("TAI_VERIFY_EACH");
  return given && StringRef(given) == "1";
}

/// True for the project's own LLVM passes, whose names contain its namespace.
static bool isOurs(StringRef pass) {
  return pass.contains("tai::") || pass.contains("StencilGVN");
}

void mlir::tai::verifyOwnPasses(PassInstrumentationCallbacks &callbacks) {
  if (!verifiesEach())
    return;
  callbacks.registerAfterPassCallback(
      [](StringRef pass, Any ir, const PreservedAnalyses &) {
        const auto *function = llvm::any_cast<const Function *>(&ir);
        if (!function || !isOurs(pass))
          return;
        std::string message;
        raw_string_ostream stream(message);
        if (verifyFunction(**function, &stream))
          report_fatal_error(Twine("not valid after ") + pass + ": " + message,
                             /*gen_crash_diag=*/false);
      });
}
