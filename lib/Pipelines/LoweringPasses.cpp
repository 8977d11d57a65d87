//===- LoweringPasses.cpp - Common lowering passes ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "LoweringPasses.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Transforms/Passes.h"
#include "tai/AD/Passes.h"
#include "tai/Conversion/Passes.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Utils/Canonicalization.h"

using namespace mlir;

void tai::addInliner(OpPassManager &pm) {
  pm.addPass(createVerifyInlinable());
  pm.addPass(createInlinerPass({}, [](OpPassManager &) {}));
}

void tai::addContextModes(OpPassManager &pm, const LoweringOptions &options) {
  if (options.deterministic)
    pm.addPass(createFixSumOrder());
}

void tai::addContextModes(OpPassManager &pm, const AutodiffOptions &options) {
  if (options.deterministic)
    pm.addPass(createFixSumOrder());
}

void tai::addSourcePasses(OpPassManager &pm, const LoweringOptions &options,
                          bool oneThread) {
  bool checked = options.checksIndices();
  pm.addPass(createExpandGradients());
  pm.addPass(createCheckLowerable());
  addContextModes(pm, options);
  // Launches are fused first, while kernels are as the program wrote them.
  if (options.optLevel > 0 && !checked && options.bounds != BoundsMode::Clamp &&
      options.fuseLaunches) {
    pm.addPass(createFuseLaunches());
  }

  // Helpers are inlined into the kernels that call them.
  addInliner(pm);
  RecognizeReductionsOptions reductions;
  reductions.checks = true;
  reductions.oneThread = oneThread;
  pm.addPass(createRecognizeReductions(reductions));

  // Angles are folded before any other pass that folds constants.
  addPerFunction(pm, [](OpPassManager &function) {
    function.addPass(createFoldAngles());
  });

  // Indices are checked in the program as written, so that a report names the
  // index that the program computed. From here on, kernels with run-time checks
  // are not changed.
  OpPassManager &kernels = pm.nest<KernelOp>();
  CheckBoundsOptions bounds;
  if (!checked && options.bounds == BoundsMode::Clamp) {
    bounds.bounds = BoundsMode::Clamp;
    kernels.addPass(createCheckBounds(bounds));
  }
  bounds.bounds = checked ? BoundsMode::Check : BoundsMode::Off;
  kernels.addPass(createCheckBounds(bounds));
}

void tai::addCanonicalization(OpPassManager &pm) {
  pm.addPass(createFoldAngles());
  // Large bodies are simplified separately: the canonicaliser would visit all
  // of a body again after each rewrite in it.
  pm.addPass(createSimplifyHugeBodies());
  pm.addPass(
      createCanonicalizerPass(GreedyRewriteConfig(), tai::getBrokenPatterns()));
}

void tai::addPerFunction(OpPassManager &pm,
                         llvm::function_ref<void(OpPassManager &)> add) {
  add(pm.nest<KernelOp>());
  add(pm.nest<func::FuncOp>());
}
