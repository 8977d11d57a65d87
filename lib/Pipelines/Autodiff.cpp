//===- Autodiff.cpp - The differentiation pipeline ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "LoweringPasses.h"
#include "mlir/Pass/PassRegistry.h"
#include "mlir/Transforms/Passes.h"
#include "tai/AD/Passes.h"
#include "tai/Pipelines/Pipelines.h"
#include "tai/Transforms/Passes.h"

using namespace mlir;

/// Returns the options of a pass that concerns the kernels to be
/// differentiated.
template <typename Options>
static Options getKernelsOf(const tai::AutodiffOptions &options) {
  Options result;
  result.kernels.assign(options.kernels.begin(), options.kernels.end());
  return result;
}

void tai::buildAutodiffPasses(OpPassManager &pm,
                              const AutodiffOptions &options) {
  pm.addPass(createExpandGradients());
  addContextModes(pm, options);
  // Helpers are inlined into the kernels that call them, because a call would
  // hide their reads.
  addInliner(pm);
  pm.addPass(createRecognizeReductions());
  addPerFunction(pm, [](OpPassManager &function) {
    // Local variables become values, so that later passes see dependences.
    function.addPass(createEliminateLocals());
    addCanonicalization(function);
    // Equal indices become one value, so that accesses to equal elements are
    // recognised.
    function.addPass(createCSEPass());
  });
  pm.addPass(createExpandAtomics(getKernelsOf<ExpandAtomicsOptions>(options)));
  // The data access rules are checked on the program as written, because
  // flattened branches hide conditions.
  pm.addPass(
      createCheckAccessRules(getKernelsOf<CheckAccessRulesOptions>(options)));
  pm.addPass(
      createPromoteElements(getKernelsOf<PromoteElementsOptions>(options)));
  addPerFunction(pm, [&](OpPassManager &function) {
    function.addPass(createEliminateLocals());
    if (options.flatten)
      function.addPass(createFlattenBranches());
  });

  pm.addPass(createSplitKernel(getKernelsOf<SplitKernelOptions>(options)));
  pm.addPass(createChooseWriters(getKernelsOf<ChooseWritersOptions>(options)));

  auto adjoint = getKernelsOf<MakeAdjointOptions>(options);
  adjoint.arrayAdjoints = options.arrayAdjoints;
  adjoint.historyBytes = options.historyBytes;
  adjoint.zeroOverwritten = options.zeroOverwritten;
  adjoint.storedOutputs = options.storedOutputs;
  adjoint.skip = options.skip;
  pm.addPass(createMakeAdjoint(adjoint));

  addPerFunction(pm, [](OpPassManager &function) {
    // Derivative rules emit the formula, not its simplest form.
    addCanonicalization(function);
    function.addPass(createCSEPass());
    // Recomputations in a backward loop need not be repeated in each iteration.
    function.addPass(createLoopInvariantCodeMotionPass());
    function.addPass(createMarkExclusive());
    function.addPass(createSummarizeKernels());
  });
}

void tai::buildAutodiffPipeline(OpPassManager &pm,
                                const AutodiffOptions &options) {
  pm.addPass(
      createPrepareForeign(getKernelsOf<PrepareForeignOptions>(options)));
  addIsolated(
      pm, [&](OpPassManager &own) { buildAutodiffPasses(own, options); },
      IsolateMode::Keep, options.kernels);
}

void tai::buildForwardPipeline(OpPassManager &pm, bool arrayTangents) {
  addInliner(pm);
  pm.addPass(createRecognizeReductions());
  addPerFunction(pm, [](OpPassManager &function) {
    function.addPass(createEliminateLocals());
    addCanonicalization(function);
    function.addPass(createCSEPass());
  });
  ForwardDiffOptions forward;
  forward.arrayTangents = arrayTangents;
  pm.addPass(createForwardDiff(forward));
  addPerFunction(pm, [](OpPassManager &function) {
    // Derivative rules emit the formula, not its simplest form.
    addCanonicalization(function);
    function.addPass(createCSEPass());
    function.addPass(createMarkExclusive());
  });
}

void tai::buildForwardFunctionsPipeline(OpPassManager &pm) {
  pm.addPass(createPrepareForeign());
  addIsolated(pm,
              [](OpPassManager &own) {
                buildForwardPipeline(own, /*arrayTangents=*/true);
              },
              IsolateMode::Keep, {});
}

void tai::registerAutodiffPipeline() {
  PassPipelineRegistration<>(
      "tai-autodiff-forward",
      "Make the tangents of kernels and functions (forward mode)",
      buildForwardFunctionsPipeline);
  PassPipelineRegistration<AutodiffOptions>(
      "tai-autodiff",
      "Make the adjoints of kernels, and the summaries of all kernels",
      buildAutodiffPipeline);
}
