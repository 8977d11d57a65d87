//===- ToLLVM.cpp - From kernels to the LLVM dialect ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "mlir/Pass/PassRegistry.h"
#include "mlir/Transforms/Passes.h"
#include "tai/Conversion/Passes.h"
#include "tai/Dialect/Tai/Transforms/Passes.h"
#include "tai/Pipelines/Pipelines.h"

using namespace mlir;

void tai::buildToLLVMPasses(OpPassManager &pm, const ToLLVMOptions &options) {
  bool checked = options.checksIndices();
  bool fast = options.optLevel > 0;

  // While kernels are as they were written.
  if (fast && !checked && options.bounds != BoundsMode::Clamp &&
      options.fuseLaunches) {
    FuseLaunchesOptions fuse;
    fuse.deterministic = options.deterministic;
    pm.addPass(createFuseLaunches(fuse));
  }

  // Helpers go into the kernels that call them. The inliner's own cleaning of
  // every function costs more than all that follows, so it is left out.
  pm.addPass(createInlinerPass({}, [](OpPassManager &) {}));

  // On the program as it was written: a report names the index that the program
  // computed. From here on, kernels that check as they run are left alone.
  CheckBoundsOptions bounds;
  if (!checked && options.bounds == BoundsMode::Clamp) {
    bounds.bounds = BoundsMode::Clamp;
    pm.addPass(createCheckBounds(bounds));
  }
  bounds.bounds = checked ? BoundsMode::Check : BoundsMode::Off;
  pm.addPass(createCheckBounds(bounds));

  if (fast) {
    pm.addPass(createMarkExclusive());
    pm.addPass(createGatherAccumulations());
    pm.addPass(createNormalizeIndices());
    pm.addPass(createSplitInterior());
    // The interior's answers are constants now, and dead questions go.
    pm.addPass(createCanonicalizerPass());
  }

  // From here on values are scalars, and loops run over boxes.
  pm.addPass(createScalarize());
  // Of scalars, while loops over fields still say what their indices are.
  GuardDivisionsOptions divisions;
  divisions.debug = options.debug;
  pm.addPass(createGuardDivisions(divisions));
  // Both are the business of the loop over blocks too.
  if (fast && options.skip.has(Skip::ActivationDemotion) &&
      options.skip.has(Skip::AccessorHoisting))
    pm.addPass(createVectorizeBlocks());
  LowerStructForOptions loops;
  loops.deterministic = options.deterministic;
  loops.skip = options.skip;
  pm.addPass(createLowerStructFor(loops));

  if (fast)
    pm.addPass(createCSEPass());

  // How accumulations are done is decided while they still name fields.
  RelaxAtomicsOptions relax;
  relax.deterministic = options.deterministic;
  pm.addPass(createRelaxAtomics(relax));

  LowerLayoutOptions layout;
  layout.boundsCheck = checked;
  pm.addPass(createLowerLayout(layout));

  ConvertTaiToSCFOptions scf;
  scf.deterministic = options.deterministic;
  scf.debug = options.debug;
  pm.addPass(createConvertTaiToSCF(scf));
  if (fast)
    pm.addPass(createHoistAllocations());
  if (fast)
    pm.addPass(createSplitLoops());

  ConvertToLLVMOptions llvm;
  llvm.fastMath = options.fastMath;
  llvm.contract = options.contract;
  pm.addPass(createConvertToLLVM(llvm));
  pm.addPass(createVerifyLLVM());
}

void tai::buildToLLVMPipeline(OpPassManager &pm, const ToLLVMOptions &options) {
  addIsolated(pm, [&](OpPassManager &own) { buildToLLVMPasses(own, options); });
}

void tai::registerToLLVMPipeline() {
  PassPipelineRegistration<ToLLVMOptions>(
      "tai-to-llvm",
      "Lower trees, fields, kernels and host functions to the LLVM dialect",
      buildToLLVMPipeline);
}
