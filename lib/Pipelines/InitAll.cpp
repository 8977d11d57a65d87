//===- InitAll.cpp - Registration of everything in tai --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/InitAll.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/ControlFlow/IR/ControlFlow.h"
#include "mlir/Dialect/Func/Extensions/InlinerExtension.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/GPU/IR/GPUDialect.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/LLVMIR/NVVMDialect.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/UB/IR/UBOps.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "tai/AD/Passes.h"
#include "tai/Conversion/Passes.h"
#include "tai/Conversion/ToLLVM/Interfaces.h"
#include "tai/Dialect/Check/IR/Check.h"
#include "tai/Dialect/Mesh/IR/Mesh.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "tai/Interfaces/Differentiable.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Shards/Passes.h"
#include "tai/Transforms/Simplify/WidenArithmetic.h"

using namespace mlir;

void tai::registerAll(DialectRegistry &registry) {
  registry.insert<TaiDialect, TaiRTDialect, TaiMeshDialect, arith::ArithDialect,
                  cf::ControlFlowDialect, func::FuncDialect, gpu::GPUDialect,
                  LLVM::LLVMDialect, math::MathDialect, memref::MemRefDialect,
                  NVVM::NVVMDialect, scf::SCFDialect, ub::UBDialect,
                  vector::VectorDialect>();
  registerCheckDialect(registry);
  func::registerInlinerExtension(registry);
  registerDifferentiableModels(registry);
  registerToLLVMInterfaces(registry);
}

void tai::registerAllPasses() {
  registerTaiADPasses();
  registerTaiTransformsPasses();
  registerTaiShardsPasses();
  registerTaiConversionPasses();
  registerIsolate();
  registerWidenArithmetic();
  registerAutodiffPipeline();
  registerToLLVMPipeline();
  registerToNVVMPipeline();
}

void tai::buildPipeline(OpPassManager &pm, const ToLLVMOptions &options) {
  buildAutodiffPipeline(pm, AutodiffOptions());
  buildToLLVMPipeline(pm, options);
}
