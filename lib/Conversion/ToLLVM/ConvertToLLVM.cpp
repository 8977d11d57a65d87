//===- ConvertToLLVM.cpp - The last conversion ----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "DetachExits.h"

#include "mlir/Conversion/ArithToLLVM/ArithToLLVM.h"
#include "mlir/Conversion/ControlFlowToLLVM/ControlFlowToLLVM.h"
#include "mlir/Conversion/ConvertToLLVM/ToLLVMPass.h"
#include "mlir/Conversion/FuncToLLVM/ConvertFuncToLLVM.h"
#include "mlir/Conversion/LLVMCommon/ConversionTarget.h"
#include "mlir/Conversion/LLVMCommon/TypeConverter.h"
#include "mlir/Conversion/MathToLLVM/MathToLLVM.h"
#include "mlir/Conversion/MathToLibm/MathToLibm.h"
#include "mlir/Conversion/SCFToControlFlow/SCFToControlFlow.h"
#include "mlir/Conversion/UBToLLVM/UBToLLVM.h"
#include "mlir/Dialect/Arith/Transforms/Passes.h"
#include "mlir/Dialect/ControlFlow/IR/ControlFlow.h"
#include "mlir/Dialect/ControlFlow/IR/ControlFlowOps.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/GPU/IR/GPUDialect.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/LLVMIR/NVVMDialect.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/Math/Transforms/Passes.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "tai/Conversion/Passes.h"
#include "tai/Conversion/ToLLVM/FloatOptions.h"
#include "tai/Conversion/ToLLVM/Interfaces.h"
#include "tai/Dialect/Tai/IR/Modes.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"
#include "llvm/ADT/StringSet.h"

namespace mlir::tai {
#define GEN_PASS_DEF_CONVERTTOLLVM
#define GEN_PASS_DEF_CHECKLOWERABLE
#define GEN_PASS_DEF_VERIFYLLVM
#include "tai/Conversion/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

void tai::setFloatOptions(Operation *root, bool fastMath, bool contract) {
  using arith::FastMathFlags;
  FastMathFlags flags = FastMathFlags::none;
  if (contract)
    flags = flags | FastMathFlags::contract;
  if (fastMath)
    flags = flags | FastMathFlags::reassoc | FastMathFlags::nsz |
            FastMathFlags::arcp | FastMathFlags::contract | FastMathFlags::afn;
  root->walk([&](Operation *op) {
    auto arithmetic = dyn_cast<arith::ArithFastMathInterface>(op);
    // Fast-math flags do not speed up comparisons and selects, and must not
    // change their results; LLVM has no such flags for conversions.
    if (!arithmetic ||
        isa<arith::CmpFOp, arith::SelectOp, arith::ExtFOp, arith::TruncFOp>(op))
      return;
    FastMathFlags old = FastMathFlags::none;
    if (arith::FastMathFlagsAttr attr = arithmetic.getFastMathFlagsAttr())
      old = attr.getValue();
    op->setAttr(arithmetic.getFastMathAttrName(),
                arith::FastMathFlagsAttr::get(op->getContext(), old | flags));
  });
}

/// Emits a constant of a float type, or a vector with this constant in each
/// lane.
static Value emitFloat(OpBuilder &builder, Location loc, Type type,
                       const APFloat &value) {
  TypedAttr attr = builder.getFloatAttr(getElementTypeOrSelf(type), value);
  if (auto shaped = dyn_cast<ShapedType>(type))
    attr = DenseElementsAttr::get(shaped, Attribute(attr));
  return arith::ConstantOp::create(builder, loc, attr);
}

static const llvm::fltSemantics &getSemantics(Type type) {
  return cast<FloatType>(getElementTypeOrSelf(type)).getFloatSemantics();
}

namespace {
/// clampf %x to [%lo, %hi]  ->  minimumf (maximumf %x, %lo), %hi
/// Upstream's expansion swaps the bounds.
struct ExpandClamp : OpRewritePattern<math::ClampFOp> {
  using OpRewritePattern::OpRewritePattern;
  LogicalResult matchAndRewrite(math::ClampFOp op,
                                PatternRewriter &rewriter) const override {
    Value low = arith::MaximumFOp::create(rewriter, op.getLoc(), op.getValue(),
                                          op.getMin(), op.getFastmathAttr());
    rewriter.replaceOpWithNewOp<arith::MinimumFOp>(op, low, op.getMax(),
                                                   op.getFastmathAttr());
    return success();
  }
};

/// isinf %x  ->  |x| == infinity. Upstream lowers isinf to a test of float
/// classes only in a pass of its own.
struct ExpandIsInf : OpRewritePattern<math::IsInfOp> {
  using OpRewritePattern::OpRewritePattern;
  LogicalResult matchAndRewrite(math::IsInfOp op,
                                PatternRewriter &rewriter) const override {
    Location loc = op.getLoc();
    Type type = op.getOperand().getType();
    Value size = math::AbsFOp::create(rewriter, loc, op.getOperand());
    rewriter.replaceOpWithNewOp<arith::CmpFOp>(
        op, arith::CmpFPredicate::OEQ, size,
        emitFloat(rewriter, loc, type, APFloat::getInf(getSemantics(type))));
    return success();
  }
};

/// isnormal %x  ->  the smallest normal <= |x| < infinity
struct ExpandIsNormal : OpRewritePattern<math::IsNormalOp> {
  using OpRewritePattern::OpRewritePattern;
  LogicalResult matchAndRewrite(math::IsNormalOp op,
                                PatternRewriter &rewriter) const override {
    Location loc = op.getLoc();
    Type type = op.getOperand().getType();
    auto constant = [&](const APFloat &value) {
      return emitFloat(rewriter, loc, type, value);
    };
    const llvm::fltSemantics &semantics = getSemantics(type);
    Value size = math::AbsFOp::create(rewriter, loc, op.getOperand());
    Value isLarge = arith::CmpFOp::create(
        rewriter, loc, arith::CmpFPredicate::OGE, size,
        constant(APFloat::getSmallestNormalized(semantics)));
    Value isFinite =
        arith::CmpFOp::create(rewriter, loc, arith::CmpFPredicate::OLT, size,
                              constant(APFloat::getInf(semantics)));
    rewriter.replaceOpWithNewOp<arith::AndIOp>(op, isLarge, isFinite);
    return success();
  }
};

/// scf.index_switch  ->  cf.switch of i64. Upstream truncates index and cases
/// to 32 bits, so that 2^32 matches case 0.
struct LowerIndexSwitch : OpRewritePattern<scf::IndexSwitchOp> {
  using OpRewritePattern::OpRewritePattern;
  LogicalResult matchAndRewrite(scf::IndexSwitchOp op,
                                PatternRewriter &rewriter) const override {
    Location loc = op.getLoc();
    Block *before = rewriter.getInsertionBlock();
    Block *after = rewriter.splitBlock(before, Block::iterator(op));
    for (Type type : op.getResultTypes())
      after->addArgument(type, loc);
    auto inlineRegion = [&](Region &region) {
      Block *block = &region.front();
      auto yield = cast<scf::YieldOp>(block->getTerminator());
      rewriter.setInsertionPoint(yield);
      rewriter.replaceOpWithNewOp<cf::BranchOp>(yield, after,
                                                yield.getOperands());
      rewriter.inlineRegionBefore(region, after);
      return block;
    };
    SmallVector<Block *> blocks;
    for (Region &region : op.getCaseRegions())
      blocks.push_back(inlineRegion(region));
    Block *otherwise = inlineRegion(op.getDefaultRegion());
    SmallVector<APInt> cases;
    for (int64_t value : op.getCases())
      cases.emplace_back(64, value, /*isSigned=*/true);

    rewriter.setInsertionPointToEnd(before);
    Value flag = arith::IndexCastOp::create(rewriter, loc,
                                            rewriter.getI64Type(), op.getArg());
    cf::SwitchOp::create(rewriter, loc, flag, otherwise, ValueRange(), cases,
                         blocks, SmallVector<ValueRange>(blocks.size()));
    rewriter.replaceOp(op, after->getArguments());
    return success();
  }
};

/// Casts a float to an integer like the hardware, also if the float is out of
/// the integer's range: LLVM's cast then yields poison, which may be a
/// different number at each use; freezing makes it one number.
template <typename FromT, typename ToT>
struct CastFloat : OpConversionPattern<FromT> {
  using OpConversionPattern<FromT>::OpConversionPattern;
  LogicalResult
  matchAndRewrite(FromT op, typename FromT::Adaptor adaptor,
                  ConversionPatternRewriter &rewriter) const override {
    Type type = this->getTypeConverter()->convertType(op.getType());
    if (!isa_and_present<IntegerType>(type))
      return failure();
    Value cast = ToT::create(rewriter, op.getLoc(), type, adaptor.getIn());
    rewriter.replaceOpWithNewOp<LLVM::FreezeOp>(op, cast);
    return success();
  }
};
} // namespace

/// Emits a constant of the type of `like`, which is f32 or a vector of f32.
static Value createF32(OpBuilder &builder, Location loc, Value like,
                       double number) {
  TypedAttr value = builder.getF32FloatAttr(number);
  if (auto vector = dyn_cast<VectorType>(like.getType()))
    value = DenseElementsAttr::get(vector, Attribute(value));
  return arith::ConstantOp::create(builder, loc, value);
}

namespace {
/// The polynomials take the smallest normal number for denormal operands, and
/// have no denormal results. For these arguments,
/// exp %x  ->  exp (%x + 32 ln 2) 2^-32
/// log %x  ->  log (%x 2^32) - 32 ln 2
/// The created op is left to the polynomials: a conversion does not apply a
/// pattern to the pattern's own results.
template <typename Op> struct KeepDenormals : OpRewritePattern<Op> {
  using OpRewritePattern<Op>::OpRewritePattern;
  LogicalResult matchAndRewrite(Op op,
                                PatternRewriter &rewriter) const override {
    if (!getElementTypeOrSelf(op.getType()).isF32())
      return failure();
    constexpr bool isExp = std::is_same_v<Op, math::ExpOp>;
    Location loc = op.getLoc();
    Value x = op.getOperand();
    auto constant = [&](double number) {
      return createF32(rewriter, loc, x, number);
    };
    Value shift = constant(22.180709777918249);
    Value scale = constant(isExp ? 0x1p-32 : 0x1p+32);
    auto select = [&](Value yes, Value no) {
      Value isSmall =
          arith::CmpFOp::create(rewriter, loc, arith::CmpFPredicate::OLT, x,
                                constant(isExp ? -87 : 0x1p-126));
      return arith::SelectOp::create(rewriter, loc, isSmall, yes, no);
    };
    Value moved;
    if constexpr (isExp)
      moved = arith::AddFOp::create(rewriter, loc, x, shift);
    else
      moved = arith::MulFOp::create(rewriter, loc, x, scale);
    Value result = Op::create(rewriter, loc, select(moved, x));
    Value back;
    if constexpr (isExp)
      back = arith::MulFOp::create(rewriter, loc, result, scale);
    else
      back = arith::SubFOp::create(rewriter, loc, result, shift);
    rewriter.replaceOp(op, select(back, result));
    return success();
  }
};
} // namespace

/// Adds expansions of math ops that upstream lacks or gets wrong.
static void populateExpansionFixes(RewritePatternSet &patterns) {
  // The op sincos is expanded, because LLVM 22 crashes when it vectorises a
  // loop with the intrinsic for sine and cosine together; it combines sin and
  // cos by itself.
  math::populateExpansionPatterns(patterns, {"sincos"});
  // Upstream expands expm1 to e^x - 1, which cancels for small x.
  llvm::erase_if(patterns.getNativePatterns(), [](const auto &pattern) {
    std::optional<OperationName> root = pattern->getRootKind();
    return root && root->getStringRef() == math::ExpM1Op::getOperationName() &&
           pattern->getBenefit() == 1;
  });
  patterns.add<ExpandClamp, ExpandIsInf, ExpandIsNormal>(patterns.getContext());
}

void tai::populateSharedToLLVM(const LLVMTypeConverter &converter,
                               RewritePatternSet &patterns) {
  populateSCFToControlFlowConversionPatterns(patterns);
  arith::populateCeilFloorDivExpandOpsPatterns(patterns);
  arith::populateArithToLLVMConversionPatterns(converter, patterns);
  cf::populateControlFlowToLLVMConversionPatterns(converter, patterns);
  ub::populateUBToLLVMConversionPatterns(converter, patterns);
  populateMathToLLVMConversionPatterns(converter, patterns,
                                       /*approximateLog1p=*/false);
  populateExpansionFixes(patterns);
  // These patterns for casts and switches take precedence over upstream's
  // patterns.
  patterns.add<LowerIndexSwitch>(patterns.getContext(), /*benefit=*/2);
  patterns.add<CastFloat<arith::FPToSIOp, LLVM::FPToSIOp>,
               CastFloat<arith::FPToUIOp, LLVM::FPToUIOp>>(
      converter, patterns.getContext(), /*benefit=*/2);
}

/// Allows contraction of elementary functions, so that VectorMath.h may call
/// functions of other libraries than libm. Arithmetic keeps its flags: its bits
/// must not depend on fusion.
static void relaxMathOps(Operation *root) {
  root->walk([](Operation *op) {
    auto arithmetic = dyn_cast<arith::ArithFastMathInterface>(op);
    if (!arithmetic || !isa<math::MathDialect>(op->getDialect()) ||
        isa<math::FmaOp, math::SqrtOp>(op))
      return;
    auto flags = arith::FastMathFlags::contract;
    if (arith::FastMathFlagsAttr attr = arithmetic.getFastMathFlagsAttr())
      flags = flags | attr.getValue();
    op->setAttr(arithmetic.getFastMathAttrName(),
                arith::FastMathFlagsAttr::get(op->getContext(), flags));
  });
}

/// Calls of libm get the properties of intrinsics: they access no memory (errno
/// is not used), and may be contracted.
static void relaxMathCalls(LLVM::LLVMFuncOp function, bool contract) {
  // Functions of libm for which LLVM has no intrinsic.
  static const llvm::StringSet<> names{"expm1", "expm1f", "log1p", "log1pf",
                                       "cbrt",  "cbrtf",  "erf",   "erff",
                                       "erfc",  "erfcf",  "asinh", "asinhf",
                                       "acosh", "acoshf", "atanh", "atanhf"};
  function.walk([&](LLVM::CallOp call) {
    std::optional<StringRef> callee = call.getCallee();
    if (!callee || !names.contains(*callee))
      return;
    auto none = LLVM::ModRefInfo::NoModRef;
    call.setMemoryEffectsAttr(LLVM::MemoryEffectsAttr::get(
        call.getContext(), none, none, none, none, none, none));
    call.setNoUnwind(true);
    call.setWillReturn(true);
    if (contract)
      call.setFastmathFlags(call.getFastmathFlags() |
                            LLVM::FastmathFlags::contract);
  });
}

/// Returns the ops of the module that are lowered, and the functions that they
/// call.
static llvm::SetVector<Operation *> collectWithCallees(ModuleOp module) {
  llvm::SetVector<Operation *> ops = collectLowered(module);
  addCallees(module, ops);
  return ops;
}

/// Walks over the ops that are lowered, up to the first for which `check`
/// fails.
static LogicalResult
checkLowered(ModuleOp module,
             llvm::function_ref<LogicalResult(Operation *)> check) {
  for (Operation *root : collectWithCallees(module)) {
    // Ops are visited in pre-order, so that an op is reported before the ops
    // inside it.
    WalkResult result = root->walk<WalkOrder::PreOrder>(
        [&](Operation *op) { return WalkResult(check(op)); });
    if (result.wasInterrupted())
      return failure();
  }
  return success();
}

namespace {
struct ConvertToLLVM : tai::impl::ConvertToLLVMBase<ConvertToLLVM> {
  using Base::Base;

  void getDependentDialects(DialectRegistry &registry) const override {
    Base::getDependentDialects(registry);
    registerConvertToLLVMDependentDialectLoading(registry);
  }

  void runOnOperation() override {
    ModuleOp module = getOperation();
    MLIRContext *context = &getContext();
    llvm::SetVector<Operation *> lowered = collectWithCallees(module);
    // Ops of the dialect tai with regions must be gone: their regions have a
    // single block, and lowering a loop inside would create several.
    WalkResult result = module.walk([](Operation *op) {
      if (op->getNumRegions() == 0 ||
          !isa_and_present<TaiDialect>(op->getDialect()))
        return WalkResult::advance();
      op->emitOpError("reaches the last conversion; expects convert-tai-to-scf "
                      "to run before");
      return WalkResult::interrupt();
    });
    if (result.wasInterrupted())
      return signalPassFailure();
    for (Operation *op : lowered) {
      if (failed(verifyPassedModes(op)))
        return signalPassFailure();
      detachExits(op);
      std::optional<MathMode> own = Modes::of(op).math;
      // Calls may be vectorised in this case, because vector versions of
      // functions yield the same bits in the remainder of a vectorised loop as
      // in its vectors.
      if (own != MathMode::Strict && hasFixedBits(op))
        relaxMathOps(op);
      setFloatOptions(op, own ? own == MathMode::Fast : fastMath,
                      contract && own != MathMode::Strict);
    }

    LLVMTypeConverter converter(context);
    RewritePatternSet patterns(context);
    populateSharedToLLVM(converter, patterns);
    // In fast mode, polynomials of f32 with errors of some units in the last
    // place are used: loops with them can be vectorised, loops with calls of
    // libm cannot.
    if (fastMath) {
      patterns.add<KeepDenormals<math::ExpOp>, KeepDenormals<math::LogOp>>(
          context, /*benefit=*/3);
      populateMathPolynomialApproximationPatterns(
          patterns,
          [](StringRef name) {
            return llvm::is_contained({"math.exp", "math.log", "math.tanh"},
                                      name);
          },
          /*benefit=*/2);
    } else if (contract) {
      populateWideMath(patterns, /*benefit=*/2);
    }
    if (llvm::any_of(lowered, [](Operation *op) {
          return isa<LLVM::LLVMFuncOp>(op) && Modes::of(op).isAccurate();
        }))
      populateAccurateMath(patterns, /*benefit=*/1);
    // Math ops for which LLVM has no intrinsic become calls of libm.
    populateMathToLibmConversionPatterns(patterns, /*benefit=*/0);
    populateFuncToLLVMConversionPatterns(converter, patterns);

    LLVMConversionTarget target(*context);
    populateOwnConversions(lowered.getArrayRef(), target, converter, patterns);
    if (failed(applyPartialConversion(lowered.getArrayRef(), target,
                                      std::move(patterns))) ||
        failed(flushDenormals(module)))
      return signalPassFailure();
    for (Operation *op : collectWithCallees(module)) {
      auto function = dyn_cast<LLVM::LLVMFuncOp>(op);
      if (!function)
        continue;
      relaxMathCalls(function, Modes::of(function).math != MathMode::Strict);
      // Loop annotations are moved to LLVM branches here, because the
      // conversions keep them only as discardable attributes.
      function.walk([](LLVM::BrOp branch) {
        if (auto annotation = dyn_cast_if_present<LLVM::LoopAnnotationAttr>(
                branch->removeDiscardableAttr("llvm.loop_annotation")))
          branch.setLoopAnnotationAttr(annotation);
      });
    }
  }
};

/// True for the dialects that this pass, or the passes before it, lower.
bool isLowered(StringRef dialect) {
  return llvm::is_contained({"arith", "builtin", "cf", "func", "llvm", "math",
                             "memref", "scf", "tai", "tai_check", "ub",
                             "vector"},
                            dialect);
}

/// Returns the remedy for an op of a supported dialect that is not lowered, or
/// for an op of a GPU dialect; otherwise empty.
StringRef findRemedy(Operation *op) {
  if (isa<scf::ParallelOp, scf::ForallOp>(op))
    return "write 'tai.parallel_for' at the top level of a kernel for "
           "iterations that run in parallel, or 'scf.for' for those that run "
           "in order ('scf-forall-to-for' and "
           "'scf-parallel-for-to-nested-fors' make it)";
  if (isa<cf::AssertOp>(op))
    return "write 'tai.assert'";
  if (isa<vector::PrintOp, gpu::PrintfOp>(op))
    return "write 'tai.print'";
  if (isa<vector::VectorScaleOp, vector::ScalableExtractOp,
          vector::ScalableInsertOp>(op))
    return "use vectors of a fixed length";
  if (isa<math::IPowIOp>(op))
    return "multiply in a loop, or write 'math.fpowi' for floats";
  if (isa<arith::ScalingExtFOp, arith::ScalingTruncFOp>(op))
    return "multiply by the scale";
  if (isa<memref::AllocaScopeOp>(op))
    return "leave the scope out; 'memref.alloca' makes one array for the "
           "kernel, wherever it stands";
  if (isa<memref::GetGlobalOp>(op))
    return "pass the array as an argument, or put the numbers into a field";
  if (isa_and_present<gpu::GPUDialect, NVVM::NVVMDialect>(op->getDialect()))
    return "write 'tai.parallel_for'; the lowering chooses blocks and threads, "
           "and copies data to the device";
  return {};
}

/// Returns the first float type among the results that tai does not support, or
/// null.
Type findUnknownFloat(Operation *op) {
  for (Type type : op->getResultTypes()) {
    Type element = getElementTypeOrSelf(type);
    if (isa<FloatType>(element) &&
        !isa<Float16Type, BFloat16Type, Float32Type, Float64Type, Float80Type,
             Float128Type>(element))
      return element;
  }
  return {};
}

LogicalResult checkLowerable(Operation *op, OwnConversions &conversions) {
  // The remedies are for ops of the program, not for device code, which was
  // generated from kernels.
  bool isOnDevice =
      isa<gpu::GPUModuleOp>(op) || op->getParentOfType<gpu::GPUModuleOp>();
  StringRef remedy = findRemedy(op);
  if (!remedy.empty() && !isOnDevice &&
      op->getParentOfType<FunctionOpInterface>()) {
    op->emitOpError("is not lowered in code of tai").attachNote() << remedy;
    return failure();
  }
  if (Type type = findUnknownFloat(op)) {
    op->emitOpError("has a result of type ")
            .append(type, ", which is not lowered in code of tai")
            .attachNote()
        << "use f16, bf16, f32 or f64";
    return failure();
  }
  StringRef dialect = op->getName().getDialectNamespace();
  if (isLowered(dialect) || dialect == "gpu" || dialect == "nvvm" ||
      conversions.covers(op))
    return success();
  op->emitOpError("is not lowered by this pipeline").attachNote()
      << "run the passes that turn the dialect '" << dialect
      << "' into those of arith, math, scf, memref, vector and func before";
  return failure();
}

struct CheckLowerable : tai::impl::CheckLowerableBase<CheckLowerable> {
  using Base::Base;

  void runOnOperation() override {
    OwnConversions conversions;
    if (failed(checkLowered(getOperation(), [&](Operation *op) {
          return checkLowerable(op, conversions);
        })))
      return signalPassFailure();
    markAllAnalysesPreserved();
  }
};

struct VerifyLLVM : tai::impl::VerifyLLVMBase<VerifyLLVM> {
  using Base::Base;

  void runOnOperation() override {
    auto check = [](Operation *op) -> LogicalResult {
      if (isa<ModuleOp, gpu::GPUModuleOp>(op) ||
          isa_and_present<LLVM::LLVMDialect, NVVM::NVVMDialect>(
              op->getDialect()))
        return success();
      return op->emitOpError("was not lowered to the LLVM dialect");
    };
    // The op that needs a cast is reported first, because it tells more than
    // the cast.
    auto checkOthers = [&](Operation *op) {
      return isa<UnrealizedConversionCastOp>(op) ? success() : check(op);
    };
    auto checkAll = [&](llvm::function_ref<LogicalResult(Operation *)> check) {
      if (!all)
        return checkLowered(getOperation(), check);
      WalkResult result = getOperation().walk(
          [&](Operation *op) { return WalkResult(check(op)); });
      return failure(result.wasInterrupted());
    };
    bool isLowered =
        succeeded(checkAll(checkOthers)) && succeeded(checkAll(check));
    if (!isLowered)
      return signalPassFailure();
    // This is the last pass of the lowering, so no later pass needs the mark of
    // lowered functions.
    for (Operation *op : collectWithCallees(getOperation()))
      op->walk([](LLVM::LLVMFuncOp function) { unmarkLowered(function); });
    markAllAnalysesPreserved();
  }
};
} // namespace
