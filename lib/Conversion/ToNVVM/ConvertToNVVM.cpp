//===- ConvertToNVVM.cpp - Device functions in terms of NVVM and LLVM -----===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "DeviceFloats.h"
#include "mlir/Conversion/ConvertToLLVM/ToLLVMPass.h"
#include "mlir/Conversion/GPUToNVVM/GPUToNVVMPass.h"
#include "mlir/Conversion/LLVMCommon/ConversionTarget.h"
#include "mlir/Conversion/LLVMCommon/TypeConverter.h"
#include "mlir/Conversion/MathToLibm/MathToLibm.h"
#include "mlir/Dialect/ControlFlow/IR/ControlFlow.h"
#include "mlir/Dialect/GPU/IR/GPUDialect.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/LLVMIR/NVVMDialect.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "tai/Conversion/Passes.h"
#include "tai/Conversion/TaiToGPU/LoopAccesses.h"
#include "tai/Conversion/TaiToGPU/Offload.h"
#include "tai/Conversion/ToLLVM/FloatOptions.h"
#include "tai/Conversion/ToLLVM/Interfaces.h"
#include "tai/Dialect/Tai/IR/Modes.h"
#include "tai/Dialect/Tai/IR/Ownership.h"

namespace mlir::tai {
#define GEN_PASS_DEF_CONVERTTONVVM
#include "tai/Conversion/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// Drops the functions of one iteration of kernels that flush denormals, so
/// that no program runs these kernels in tiles. On an emulated device, the body
/// of a flushing function moves to a callee, where a program would not find the
/// accesses that it redirects to overlays.
static void dropFlushingTiles(gpu::GPUModuleOp kernels) {
  for (auto function : kernels.getOps<LLVM::LLVMFuncOp>()) {
    if (!Modes::of(function).flushes() || !function->removeAttr(kTilesAttrName))
      continue;
    std::string name = (function.getSymName() + runtime::tileSuffix).str();
    if (auto tile = kernels.lookupSymbol<LLVM::LLVMFuncOp>(name))
      tile.erase();
  }
}

namespace {
/// On an emulated device: gpu.thread_id x  ->  a call of the device library.
template <typename OpT> struct AskForNumber : OpRewritePattern<OpT> {
  AskForNumber(MLIRContext *context, StringRef callee)
      : OpRewritePattern<OpT>(context), callee(callee) {}

  LogicalResult matchAndRewrite(OpT op,
                                PatternRewriter &rewriter) const override {
    Location loc = op.getLoc();
    if (op.getDimension() != gpu::Dimension::x)
      return rewriter.notifyMatchFailure(op, "grids have one dimension");
    auto kernels = op->template getParentOfType<gpu::GPUModuleOp>();
    auto function = kernels.template lookupSymbol<LLVM::LLVMFuncOp>(callee);
    if (!function) {
      OpBuilder::InsertionGuard guard(rewriter);
      rewriter.setInsertionPointToStart(&kernels.getBodyRegion().front());
      function = LLVM::LLVMFuncOp::create(
          rewriter, kernels.getLoc(), callee,
          LLVM::LLVMFunctionType::get(rewriter.getI32Type(), {}));
    }
    Value number =
        LLVM::CallOp::create(rewriter, loc, function, ValueRange()).getResult();
    rewriter.replaceOpWithNewOp<arith::IndexCastOp>(op, rewriter.getIndexType(),
                                                    number);
    return success();
  }

  StringRef callee;
};

/// Fails if the function computes an f64 function for which CUDA's library
/// allows errors of more than one unit in the last place.
LogicalResult checkAccurate(Operation *function) {
  WalkResult result = function->walk([](Operation *op) {
    if (!isa<math::AcosOp, math::AcoshOp, math::AsinOp, math::AsinhOp,
             math::AtanOp, math::Atan2Op, math::AtanhOp, math::CosOp,
             math::CoshOp, math::ErfOp, math::ErfcOp, math::PowFOp, math::SinOp,
             math::SinhOp, math::TanOp, math::TanhOp>(op) ||
        !getElementTypeOrSelf(op->getResult(0).getType()).isF64())
      return WalkResult::advance();
    op->emitError("math=\"accurate\" cannot be had for '")
        << op->getName().stripDialect()
        << "' of f64 on a GPU: its library is off by up to two units in the "
           "last place or more; compute it in f32, or on the CPU";
    return WalkResult::interrupt();
  });
  return failure(result.wasInterrupted());
}

struct ConvertToNVVM : tai::impl::ConvertToNVVMBase<ConvertToNVVM> {
  using Base::Base;

  void getDependentDialects(DialectRegistry &registry) const override {
    Base::getDependentDialects(registry);
    registerConvertToLLVMDependentDialectLoading(registry);
  }

  void runOnOperation() override {
    for (auto kernels : getOperation().getOps<gpu::GPUModuleOp>())
      if (isTaiCode(kernels) && failed(convert(kernels)))
        return signalPassFailure();
  }

  LogicalResult convert(gpu::GPUModuleOp kernels) {
    MLIRContext *context = &getContext();
    bool accurate = false;
    for (Operation &op : *kernels.getBody()) {
      if (failed(verifyPassedModes(&op)))
        return failure();
      Modes modes = Modes::of(&op);
      setFloatOptions(&op, modes.math ? modes.math == MathMode::Fast : fastMath,
                      contract && modes.math != MathMode::Strict);
      accurate |= modes.isAccurate();
      if (modes.isAccurate() && failed(checkAccurate(&op)))
        return failure();
    }

    LowerToLLVMOptions options(context);
    if (auto bits = kernels->getAttrOfType<IntegerAttr>(kIndexBitsAttrName))
      options.overrideIndexBitwidth(bits.getInt());
    LLVMTypeConverter converter(context, options);
    RewritePatternSet patterns(context);
    populateSharedToLLVM(converter, patterns);
    // Patterns of higher accuracy take precedence over calls of libdevice.
    if (accurate)
      populateAccurateMath(patterns, /*benefit=*/20, /*onDevice=*/true);
    if (emulated) {
      patterns.add<AskForNumber<gpu::ThreadIdOp>>(context, "tai_dev_thread_id");
      patterns.add<AskForNumber<gpu::BlockIdOp>>(context, "tai_dev_block_id");
      patterns.add<AskForNumber<gpu::BlockDimOp>>(context, "tai_dev_block_dim");
      patterns.add<AskForNumber<gpu::GridDimOp>>(context, "tai_dev_grid_dim");
      populateMathToLibmConversionPatterns(patterns, /*benefit=*/0);
    } else {
      configureGpuToNVVMTypeConverter(converter);
      // Patterns for approximate functions take precedence over calls of
      // libdevice.
      populateFastDeviceMath(patterns, /*benefit=*/15);
      // Calls of libdevice take precedence over LLVM's intrinsics, which the
      // backend cannot select.
      populateGpuToNVVMConversionPatterns(converter, patterns, /*benefit=*/10);
    }

    LLVMConversionTarget target(*context);
    populateOwnConversions(kernels.getOperation(), target, converter, patterns);
    target.addLegalDialect<NVVM::NVVMDialect>();
    target.addLegalOp<gpu::GPUModuleOp>();
    target.addIllegalDialect<gpu::GPUDialect>();
    target.addLegalOp<gpu::GPUModuleOp>();
    if (failed(applyPartialConversion(kernels, target, std::move(patterns))))
      return failure();
    if (emulated) {
      dropFlushingTiles(kernels);
      if (failed(flushDenormals(kernels)))
        return failure();
    }
    // Loop annotations are for the vectoriser, which is not used for a GPU;
    // keep only annotations about unrolling. scf.for passes its annotation to
    // the branch as a discardable attribute.
    kernels.walk([](LLVM::BrOp branch) {
      auto annotation = dyn_cast_if_present<LLVM::LoopAnnotationAttr>(
          branch->removeDiscardableAttr("llvm.loop_annotation"));
      if (annotation && annotation.getUnroll())
        branch.setLoopAnnotationAttr(annotation);
    });
    if (emulated)
      return success();
    for (auto function : kernels.getOps<LLVM::LLVMFuncOp>())
      if (function->hasAttr(gpu::GPUDialect::getKernelFuncAttrName())) {
        function->setAttr(NVVM::NVVMDialect::getKernelFuncAttrName(),
                          UnitAttr::get(context));
        limitRegisters(function);
      }
    for (auto function : kernels.getOps<LLVM::LLVMFuncOp>())
      if (Modes::of(function).flushes())
        flushOnDevice(function);
    return success();
  }
};
} // namespace
