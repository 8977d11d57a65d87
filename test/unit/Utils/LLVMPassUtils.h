//===- LLVMPassUtils.h - Runs a pass over a function ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TEST_UNIT_COMPILER_LLVMPASSUTILS_H
#define TEST_UNIT_COMPILER_LLVMPASSUTILS_H

#include "llvm/IR/Function.h"
#include "llvm/Passes/PassBuilder.h"

namespace mlir::tai {

/// Runs a pass of LLVM with all analyses, including those of a target if a
/// machine is given.
template <typename Pass>
void runPass(llvm::Function &function, Pass pass,
             llvm::TargetMachine *machine = nullptr) {
  llvm::LoopAnalysisManager loops;
  llvm::FunctionAnalysisManager functions;
  llvm::CGSCCAnalysisManager sccs;
  llvm::ModuleAnalysisManager modules;
  llvm::PassBuilder builder(machine);
  builder.registerModuleAnalyses(modules);
  builder.registerCGSCCAnalyses(sccs);
  builder.registerFunctionAnalyses(functions);
  builder.registerLoopAnalyses(loops);
  builder.crossRegisterProxies(loops, functions, sccs, modules);
  llvm::FunctionPassManager passes;
  passes.addPass(std::move(pass));
  passes.run(function, functions);
}

} // namespace mlir::tai

#endif // TEST_UNIT_COMPILER_LLVMPASSUTILS_H
