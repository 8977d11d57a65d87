//===- ToLLVM.cpp - Lowering to the LLVM dialect --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "LoweringPasses.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Pass/PassRegistry.h"
#include "mlir/Transforms/Passes.h"
#include "tai/Conversion/Passes.h"
#include "tai/Pipelines/Pipelines.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Shards/Passes.h"

using namespace mlir;

void tai::buildToLLVMPasses(OpPassManager &pm, const ToLLVMOptions &options) {
  bool checked = options.checksIndices();
  bool fast = options.optLevel > 0;

  addSourcePasses(pm, options, options.oneThread);
  // One thread adds in order, and gathers nothing.
  ShardOptions shards;
  shards.gathers = fast && !options.oneThread;
  pm.addPass(createShard(shards));

  addPerFunction(pm, [&](OpPassManager &function) {
    if (fast) {
      function.addPass(createVersionExtents());
      function.addPass(createUnrollStencils());
      // This pass makes versions of loops for different slots. Versions whose
      // iterations cannot meet need no order.
      function.addPass(createVersionSlots());
      function.addPass(createVersionRanges());
      function.addPass(createGatherRanges());
    }
    if (options.oneThread)
      function.addPass(createKeepOrder());
    if (fast) {
      function.addPass(createMarkExclusive());
      function.addPass(createScatterToGather());
      function.addPass(createNormalizeIndices());
      function.addPass(createVersionInterior());
      // The conditions that tai-version-interior has made constant in the
      // interior are folded.
      addCanonicalization(function);
    }
    if (fast && options.skip.has(Skip::UntakenBranches))
      function.addPass(createSinkAdjoints());
    // One test of the results replaces many tests of single values. Fast-math
    // assumes that all of these tests succeed.
    if (fast && !options.fastMath)
      function.addPass(createVersionGuards());
    // With shadow execution, vectors stay values, because memory that this pass
    // creates would have no shadows.
    if (fast && !options.shadow)
      function.addPass(createVectorsToMemory());
    // From here on, values are scalars, and loops run over boxes.
    function.addPass(createScalarize());
  });
  // Divisions are guarded when they are scalar, while loops over fields still
  // show the ranges of their indices.
  GuardDivisionsOptions divisions;
  divisions.debug = options.debug;
  addPerFunction(pm, [&](OpPassManager &function) {
    function.addPass(createGuardDivisions(divisions));
    // Vectorising blocks also omits activity tests and repeated lookups, so
    // both skips must be allowed.
    if (fast && options.skip.has(Skip::ActivityTests) &&
        options.skip.has(Skip::RepeatedLookups))
      function.addPass(createVectorizeBlocks());
    LowerStructForOptions loops;
    loops.skip = options.skip;
    function.addPass(createLowerStructFor(loops));

    if (fast)
      function.addPass(createCSEPass());

    // Accumulations are planned while they still name fields.
    function.addPass(createRelaxAtomics());
    if (fast && !options.shadow && options.skip.has(Skip::UnreadZeros))
      function.addPass(createStoreFirst());
  });

  // On the module, not on each function: loops of different functions, of which
  // one may be inlined into another, must not share an access group.
  LowerLayoutOptions layout;
  layout.boundsCheck = checked;
  pm.addPass(createLowerLayout(layout));

  ConvertTaiToSCFOptions scf;
  scf.debug = options.debug;
  pm.addPass(createConvertTaiToSCF(scf));
  if (fast) {
    OpPassManager &function = pm.nest<LLVM::LLVMFuncOp>();
    function.addPass(createHoistAllocations());
    function.addPass(createSplitIndexSets());
    // Unroll-and-jam would multiply the values that need shadows.
    if (options.shadow) {
      function.addPass(createVectorizeIterations());
    } else {
      UnrollAndJamOptions jam;
      jam.reassociate = options.fastMath;
      function.addPass(createUnrollAndJam(jam));
    }
    if (!options.shadow && options.skip.has(Skip::ZeroAdjoints))
      pm.addPass(createSkipZeroBlocks());
  }

  ConvertToLLVMOptions llvm;
  llvm.fastMath = options.fastMath;
  llvm.contract = options.contract;
  pm.addPass(createConvertToLLVM(llvm));
  if (options.shadow)
    pm.addPass(createShadowExecution());
  VerifyLLVMOptions verify;
  verify.all = true;
  pm.addPass(createVerifyLLVM(verify));
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
