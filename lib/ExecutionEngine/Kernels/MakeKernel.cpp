//===- MakeKernel.cpp - From a module to a kernel of the runtime ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Index/IR/IndexDialect.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/Verifier.h"
#include "mlir/Pass/PassManager.h"
#include "mlir/Transforms/Passes.h"
#include "tai/AD/Signature.h"
#include "tai/Analysis/KernelAccesses.h"
#include "tai/CodeGen/InjectedFailures.h"
#include "tai/Dialect/Mesh/IR/Mesh.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Modes.h"
#include "tai/ExecutionEngine/Kernels/KernelCode.h"
#include "tai/ExecutionEngine/Kernels/Summaries.h"
#include "tai/ExecutionEngine/Modes/ChosenModes.h"
#include "tai/ExecutionEngine/Reproduce/Reproducer.h"
#include "tai/Support/Places.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Simplify/WidenArithmetic.h"

using namespace mlir;
using namespace mlir::tai;

/// Describes the additional operands of the kernel's adjoint, for gradients of
/// arguments, arrays and results of the caller.
static FailureOr<runtime::CallerAdjoints> getCallerAdjoints(KernelOp kernel,
                                                            Failure &problem) {
  DiagnosticCollector collector(kernel.getContext());
  FailureOr<AdjointSignature> signature =
      AdjointSignature::get(kernel, /*arrays=*/false);
  if (failed(signature)) {
    problem = collector.take(FailureKind::Type, "the kernel is not valid");
    return failure();
  }
  runtime::CallerAdjoints adjoints;
  adjoints.hasTargets = !signature->arguments.empty();
  SmallVector<MemRefType> types = signature->getShadowTypes(kernel);
  for (auto [i, type] : llvm::enumerate(types)) {
    if (i >= signature->arguments.size())
      adjoints.results.push_back(
          {adjoints.slots,
           type.getNumElements() * type.getElementTypeBitWidth() / 8});
    else
      adjoints.hasArrays |=
          isa<MemRefType>(kernel.getArgumentTypes()[signature->arguments[i]]);
    adjoints.slots += countSlots(type);
  }
  return adjoints;
}

static std::vector<runtime::ArrayArgument> findArrays(KernelOp kernel) {
  std::vector<runtime::ArrayArgument> arrays;
  int64_t slot = 0;
  for (Type type : kernel.getArgumentTypes()) {
    if (auto array = dyn_cast<MemRefType>(type)) {
      Type element = array.getElementType();
      unsigned bits =
          element.isIntOrFloat() ? element.getIntOrFloatBitWidth() : 64;
      arrays.push_back({slot, array.getRank(), (bits + 7) / 8});
    }
    slot += countSlots(type);
  }
  return arrays;
}

/// Applies bounds="clamp", which makes the kernel a different program:
/// adjoints, summaries and keys are derived from the result.
static LogicalResult clampIndices(ModuleOp module,
                                  const CompileOptions &options,
                                  FailureLog &failures) {
  if (options.bounds != BoundsMode::Clamp || options.debug)
    return success();
  auto populate = [](OpPassManager &manager) {
    manager.addPass(createInlinerPass({}, [](OpPassManager &) {}));
    manager.addPass(createCheckBounds({BoundsMode::Clamp}));
    injectFailingPass(manager, "clamp");
  };
  Failure failure;
  if (succeeded(runPasses(module, populate, "clamping indices",
                          FailureKind::Type, failure)))
    return success();
  return failures.fail(std::move(failure));
}

/// Returns the compile options of the kernel, which its modes may change.
static FailureOr<CompileOptions> getOwnOptions(KernelOp kernel,
                                               const CompileOptions &options,
                                               FailureLog &failures) {
  if (!kernel.getModesAttr())
    return options;
  DiagnosticCollector collector(kernel.getContext());
  FailureOr<CompileOptions> own = getKernelOptions(kernel, options);
  if (failed(own))
    return failures.fail(
        collector.take(FailureKind::Usage, "the kernel's modes are not valid"));
  return own;
}

/// Applies the precision in the kernel's modes, which also makes the kernel a
/// different program.
static LogicalResult widenArithmetic(ModuleOp module, KernelOp kernel,
                                     FailureLog &failures) {
  if (!Modes::of(kernel).precision)
    return success();
  auto populate = [](OpPassManager &manager) {
    manager.addPass(createInlinerPass({}, [](OpPassManager &) {}));
    manager.addNestedPass<KernelOp>(createWidenArithmetic());
  };
  Failure failure;
  if (succeeded(runPasses(module, populate, "widening arithmetic",
                          FailureKind::Type, failure)))
    return success();
  return failures.fail(std::move(failure));
}

/// In the kernel as written, makes updates of elements that iterations share
/// atomic, or rejects these updates. With one thread, iterations run in order.
static LogicalResult recognizeReductions(ModuleOp module, KernelOp kernel,
                                         bool oneThread, FailureLog &failures) {
  bool isParallel = kernel
                        .walk([](ParallelForOp loop) {
                          return loop.getSerialize() ? WalkResult::advance()
                                                     : WalkResult::interrupt();
                        })
                        .wasInterrupted();
  if (!isParallel)
    return success();
  auto populate = [&](OpPassManager &manager) {
    manager.addPass(createInlinerPass({}, [](OpPassManager &) {}));
    RecognizeReductionsOptions reductions;
    reductions.oneThread = oneThread;
    manager.addPass(createRecognizeReductions(reductions));
  };
  Failure failure;
  if (succeeded(runPasses(module, populate, "recognising reductions",
                          FailureKind::Type, failure)))
    return success();
  return failures.fail(std::move(failure));
}

static LogicalResult verifyModule(ModuleOp module, FailureLog &failures) {
  DiagnosticCollector collector(module.getContext());
  if (succeeded(verify(module)))
    return success();
  return failures.fail(
      collector.take(FailureKind::Type, "the module does not verify"));
}

static LogicalResult checkAdjoints(ModuleOp module, const ContextModes &modes,
                                   FailureLog &failures) {
  DiagnosticCollector collector(module.getContext());
  if (succeeded(modes.checkFields(module)))
    return success();
  return failures.fail(collector.take(FailureKind::Usage));
}

/// True if the kernel does nothing but compute from its arguments and fields:
/// no random numbers, output or calls, and no fields that other processes
/// share.
static bool isRepeatable(ModuleOp module, KernelOp kernel) {
  for (FieldOp field : module.getOps<FieldOp>()) {
    FailureOr<FieldLayout> layout = getFieldLayout(field);
    if (failed(layout) || getSharding(*layout))
      return false;
  }
  return !kernel
              .walk([&](Operation *op) {
                bool isKnown =
                    isPure(op) ||
                    isa<KernelOp, ParallelForOp, YieldOp, LoadOp, StoreOp,
                        ReturnOp, AllocaOp, LocalLoadOp, LocalStoreOp,
                        AssertOp>(op) ||
                    isa<arith::ArithDialect, math::MathDialect, scf::SCFDialect,
                        vector::VectorDialect, index::IndexDialect>(
                        op->getDialect());
                return isKnown ? WalkResult::advance()
                               : WalkResult::interrupt();
              })
              .wasInterrupted();
}

FailureOr<MadeKernel> mlir::tai::makeKernel(const KernelServices &services,
                                            OwningOpRef<ModuleOp> module,
                                            StringRef name,
                                            const CompileOptions &given,
                                            const ContextModes &modes) {
  FailureLog &failures = services.failures;
  auto op = module->lookupSymbol<KernelOp>(name);
  if (!op)
    return failures.fail(FailureKind::Usage,
                         "the module holds no kernel of the name '" + name +
                             "'");
  if (failed(services.declarations.declareUsed(*module)) ||
      failed(verifyModule(*module, failures)) ||
      failed(checkAdjoints(*module, modes, failures)))
    return failure();
  FailureOr<CompileOptions> options = getOwnOptions(op, given, failures);
  if (failed(options) ||
      failed(recognizeReductions(
          *module, op, !given.device && services.rt.options().threads == 1,
          failures)) ||
      failed(clampIndices(*module, *options, failures)) ||
      failed(widenArithmetic(*module, op, failures)))
    return failure();

  if (options->debug)
    op->setAttr(kCheckUpdatesAttrName, UnitAttr::get(op.getContext()));

  Failure problem;
  FailureOr<runtime::CallerAdjoints> adjoints = getCallerAdjoints(op, problem);
  if (failed(adjoints))
    return failures.fail(std::move(problem));

  const runtime::Runtime &rt = services.rt;
  KernelCode::Source source;
  source.name = name.str();
  source.options = *options;
  runtime::KernelInfo info;
  info.name = source.name;
  info.place = source.place = describePlace(op.getLoc());
  info.argSlots = source.argSlots = countSlots(op.getArgumentTypes());
  info.resultSlots = source.resultSlots = countSlots(op.getResultTypes());
  info.arrays = findArrays(op);
  info.callerAdjoints = std::move(*adjoints);
  info.summary = summarize(rt, *module, op);
  info.isRepeatable = isRepeatable(*module, op);
  for (TreeOp tree : module->getOps<TreeOp>())
    source.trees.push_back(rt.store().findTree(tree.getSymName().str()));
  for (FieldOp field : module->getOps<FieldOp>())
    if (runtime::FieldPtr known =
            rt.store().findField(field.getSymName().str()))
      source.fields[field.getSymName()] = known;
  info.trees = source.trees;
  source.module = std::move(module);
  auto code = std::make_shared<KernelCode>(services, std::move(source));
  info.provider = code;
  return MadeKernel{std::move(code),
                    services.rt.launcher().kernels().create(std::move(info))};
}
