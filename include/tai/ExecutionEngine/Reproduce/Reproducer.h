//===- Reproducer.h - Reproducers of internal errors ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An invalid program gets an error at its line. Any other failure is a bug of
// the compiler: the compiler writes a file with the module and the pass
// pipeline, which the error names.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_REPRODUCE_REPRODUCER_H
#define TAI_EXECUTIONENGINE_REPRODUCE_REPRODUCER_H

#include "mlir/Pass/PassInstrumentation.h"
#include "mlir/Pass/PassManager.h"
#include "tai/CodeGen/Diagnostics.h"

namespace mlir::tai {

/// Records the pass after which the module failed to verify.
class InvalidAfterPass : public PassInstrumentation {
public:
  struct Finding {
    std::string pass;
    /// The first error that the verifier reported after the recorded pass.
    std::string error;
  };
  explicit InvalidAfterPass(Finding &finding) : finding(finding) {}

  void runAfterPassFailed(Pass *pass, Operation *op) override;

private:
  Finding &finding;
};

/// Runs a pipeline. If a pass fails with an error about the program, the
/// failure is of `kind`. If a pass fails without a diagnostic, or leaves an
/// invalid module, the failure is internal.
LogicalResult runPipeline(PassManager &manager,
                          InvalidAfterPass::Finding &finding, ModuleOp module,
                          const Twine &title, FailureKind kind,
                          Failure &failure);

/// Writes the module and a pipeline to a file for `tai-opt --run-reproducer`.
/// The first lines of the file contain the failure, and in `next` the commands
/// after the pipeline. Adds the name of the file to the failure.
void addReproducer(Failure &failure, ModuleOp module, PassManager &manager,
                   StringRef next = {});

/// Writes a module of LLVM IR to a file, whose first lines contain the failure
/// and `command`, which compiles the file. Adds the name of the file to the
/// failure.
void addReproducer(Failure &failure, StringRef module, StringRef command);

/// Runs passes once, with a reproducer for internal errors.
LogicalResult runPasses(ModuleOp module,
                        llvm::function_ref<void(OpPassManager &)> populate,
                        const Twine &title, FailureKind kind, Failure &failure);

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_REPRODUCE_REPRODUCER_H
