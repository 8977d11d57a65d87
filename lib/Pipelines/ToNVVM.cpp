//===- ToNVVM.cpp - Lowering to device code and launches ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "LoweringPasses.h"
#include "mlir/Dialect/GPU/IR/GPUDialect.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Pass/PassRegistry.h"
#include "mlir/Transforms/Passes.h"
#include "tai/Conversion/Passes.h"
#include "tai/Pipelines/Pipelines.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Shards/Passes.h"

using namespace mlir;

void tai::buildToNVVMPasses(OpPassManager &pm, const ToNVVMOptions &options) {
  bool checked = options.checksIndices();
  bool fast = options.optLevel > 0;

  addSourcePasses(pm, options);
  ShardOptions shards;
  shards.gathers = fast;
  shards.pairSums = false;
  shards.onDevice = true;
  pm.addPass(createShard(shards));

  addPerFunction(pm, [&](OpPassManager &function) {
    if (fast) {
      function.addPass(createMarkExclusive());
      ScatterToGatherOptions gathers;
      gathers.pairSums = false;
      gathers.onDevice = true;
      function.addPass(createScatterToGather(gathers));
      function.addPass(createNormalizeIndices());
      addCanonicalization(function);
    }
    function.addPass(createScalarize());
  });
  // Divisions are guarded when they are scalar, while loops over fields still
  // show the ranges of their indices.
  GuardDivisionsOptions divisions;
  divisions.debug = options.debug;
  addPerFunction(pm, [&](OpPassManager &function) {
    function.addPass(createGuardDivisions(divisions));
    LowerStructForOptions loops;
    loops.skip = options.skip;
    function.addPass(createLowerStructFor(loops));
    if (fast) {
      function.addPass(createRerollAccumulations());
      function.addPass(createCSEPass());
    }

    RelaxAtomicsOptions relax;
    relax.onDevice = true;
    function.addPass(createRelaxAtomics(relax));
    if (fast)
      function.addPass(createCoarsenThreads());
  });

  // Indices are narrowed while accesses name fields: the parts of their
  // addresses are then known to be in range.
  pm.addPass(createNarrowIndices());
  LowerLayoutOptions layout;
  layout.boundsCheck = checked;
  layout.onDevice = true;
  pm.addPass(createLowerLayout(layout));

  ConvertTaiToGPUOptions gpu;
  gpu.debug = options.debug;
  pm.addPass(createConvertTaiToGPU(gpu));
  if (fast) {
    auto addTo = [](OpPassManager &function) {
      function.addPass(createHoistAllocations());
      function.addPass(createCSEPass());
    };
    addTo(pm.nest<gpu::GPUModuleOp>().nest<LLVM::LLVMFuncOp>());
    addTo(pm.nest<LLVM::LLVMFuncOp>());
  }

  ConvertToNVVMOptions nvvm;
  nvvm.fastMath = options.fastMath;
  nvvm.contract = options.contract;
  nvvm.emulated = options.emulated;
  pm.addPass(createConvertToNVVM(nvvm));
  pm.addPass(createLowerLaunches());
  ConvertToLLVMOptions host;
  host.contract = options.contract;
  pm.addPass(createConvertToLLVM(host));
  VerifyLLVMOptions verify;
  verify.all = true;
  pm.addPass(createVerifyLLVM(verify));
}

void tai::buildToNVVMPipeline(OpPassManager &pm, const ToNVVMOptions &options) {
  addIsolated(pm, [&](OpPassManager &own) { buildToNVVMPasses(own, options); });
}

void tai::registerToNVVMPipeline() {
  PassPipelineRegistration<ToNVVMOptions>(
      "tai-to-nvvm",
      "Lower trees, fields, kernels and host functions to device functions in "
      "the NVVM dialect and a part for the host in the LLVM dialect",
      buildToNVVMPipeline);
}
