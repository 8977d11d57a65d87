//===- Reproducer.h - What shows a failure of the compiler ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A program that is wrong gets an error at its line. Anything else that fails
// is a bug of ours, and leaves a file with the module and the passes that show
// it, which the error names.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_EXECUTIONENGINE_REPRODUCER_H
#define TAI_LIB_EXECUTIONENGINE_REPRODUCER_H

#include "mlir/Pass/PassInstrumentation.h"
#include "mlir/Pass/PassManager.h"
#include "tai/CodeGen/Diagnostics.h"

namespace mlir::tai {

/// Remembers which pass left a module behind that is not valid.
class InvalidAfterPass : public PassInstrumentation {
public:
  struct Finding {
    std::string pass;
    /// What the verifier says first.
    std::string error;
  };
  explicit InvalidAfterPass(Finding &finding) : finding(finding) {}

  void runAfterPassFailed(Pass *pass, Operation *op) override;

private:
  Finding &finding;
};

/// Runs a pipeline. Where a pass says what is wrong with the program the
/// failure is of `kind`. A pass that fails without a word, or after which the
/// module is not valid, is a bug of ours: the failure is internal then.
LogicalResult runPipeline(PassManager &manager,
                          InvalidAfterPass::Finding &finding, ModuleOp module,
                          const Twine &title, FailureKind kind,
                          Failure &failure);

/// Writes the module and a pipeline to a file that `tai-opt --run-reproducer`
/// takes, with the failure and `next`, what follows on the pipeline, in its
/// first lines. The failure names the file afterwards.
void addReproducer(Failure &failure, ModuleOp module, PassManager &manager,
                   StringRef next = {});

/// Writes a module of LLVM IR, with the failure and the command that makes code
/// of it in its first lines. The failure names the file afterwards.
void addReproducer(Failure &failure, StringRef module, StringRef command);

/// Runs passes once, with a reproducer where they fail by a bug of ours.
LogicalResult runPasses(ModuleOp module,
                        llvm::function_ref<void(OpPassManager &)> populate,
                        const Twine &title, FailureKind kind, Failure &failure);

} // namespace mlir::tai

#endif // TAI_LIB_EXECUTIONENGINE_REPRODUCER_H
