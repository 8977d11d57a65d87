//===- CodegenPasses.h - The passes of a code generator ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_CODEGENPASSES_H
#define TAI_LIB_CODEGEN_CODEGENPASSES_H

#include "tai/CodeGen/VerifyEach.h"
#include "llvm/ADT/StringRef.h"
#include "llvm/IR/LegacyPassManager.h"
#include "llvm/IR/Verifier.h"
#include "llvm/Pass.h"
#include <functional>

namespace mlir::tai {

/// The code generator's passes without strength reduction. On a CPU, that pass
/// takes half of the time of code generation, because loops over many arrays
/// have many formulas to compare, and the machine's addressing modes already
/// avoid most of the additions. On a GPU, it splits the counter of a
/// grid-stride loop into several counters, each with its own division into
/// indices.
class CodegenPasses : public llvm::legacy::PassManager {
public:
  void add(llvm::Pass *pass) override {
    if (pass->getPassName() == "Loop Strength Reduction") {
      delete pass;
      return;
    }
    if (beforeVectorizer &&
        pass->getPassName() == "GPU Load and Store Vectorizer") {
      llvm::legacy::PassManager::add(beforeVectorizer());
      if (verifiesEach())
        llvm::legacy::PassManager::add(llvm::createVerifierPass());
    }
    llvm::legacy::PassManager::add(pass);
  }

  /// Creates a pass that runs before loads and stores are vectorised, when
  /// addresses have their final form.
  std::function<llvm::Pass *()> beforeVectorizer;
};

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_CODEGENPASSES_H
