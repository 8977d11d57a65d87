//===- ConvertTaiToSCF.cpp - Kernels become functions ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Gives kernels and host functions the signature that the runtime calls, and
// removes the last ops of the dialect. Bodies are moved, not copied: each piece
// of code is compiled once.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "tai/Conversion/Passes.h"
#include "tai/Conversion/TaiToHost/Lowering.h"
#include "tai/Dialect/Tai/IR/Modes.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Dialect/Tai/IR/StoresFirst.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "llvm/Analysis/TargetLibraryInfo.h"
#include "llvm/TargetParser/Triple.h"

namespace mlir::tai {
#define GEN_PASS_DEF_CONVERTTAITOSCF
#include "tai/Conversion/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

ModuleLowering::ModuleLowering(ModuleOp module, bool debug, Operation *table)
    : module(module), runtime(table ? table : module.getOperation()),
      fields(module), debug(debug) {
  for (auto [i, tree] : llvm::enumerate(module.getOps<TreeOp>()))
    treeIndex[tree.getSymNameAttr()] = i;
  functions = collectLowered(module);
  addCallees(module, functions);
}

/// True if the launch can fail in one of the functions, or in a function that
/// the runtime calls for it.
static bool canFail(ArrayRef<LLVM::LLVMFuncOp> functions) {
  for (LLVM::LLVMFuncOp function : functions) {
    WalkResult result = function.walk([](LLVM::CallOp call) {
      std::optional<StringRef> callee = call.getCallee();
      return callee &&
                     llvm::is_contained({"tai_rt_fail", "tai_rt_scratch",
                                         "tai_rt_private", "tai_rt_stack_grow",
                                         "tai_rt_rank", "tai_rt_exchange"},
                                        *callee)
                 ? WalkResult::interrupt()
                 : WalkResult::advance();
    });
    if (result.wasInterrupted())
      return true;
  }
  return false;
}

LogicalResult tai::lowerKernel(KernelOp kernel, ModuleLowering &lowering) {
  std::string name = getEntryPointName(kernel.getSymName());
  Location loc = kernel.getLoc();
  RuntimeCalls &runtime = lowering.runtime;
  auto function = createFunction(lowering.module, loc, name,
                                 IntegerType::get(kernel.getContext(), 32),
                                 {runtime.getPointerType()},
                                 /*isInternal=*/false);
  const Modes modes = Modes::of(kernel);
  modes.setOn(function);
  if (auto fields = kernel->getAttrOfType<ArrayAttr>(kStoresFirst))
    setStoresFirst(function, fields);
  Block *entry = &function.getBody().front();
  Value frame = entry->getArgument(0);

  Block &body = kernel.getBody().front();
  OpBuilder builder = OpBuilder::atBlockEnd(entry);
  if (failed(replaceArguments(kernel, frame, builder, runtime)))
    return failure();
  entry->getOperations().splice(entry->end(), body.getOperations());

  Operation *ret = entry->getTerminator();
  replaceReturn(ret, ret->getLoc(), frame, builder, runtime);

  SmallVector<LLVM::LLVMFuncOp> functions{function};
  SmallVector<ParallelForOp> loops;
  numberDraws(function, {});
  function.walk([&](ParallelForOp loop) { loops.push_back(loop); });
  for (auto [i, loop] : llvm::enumerate(loops)) {
    std::string loopName = name + ".loop" + llvm::Twine(i).str();
    if (failed(lowerParallelFor(loop, frame, loopName, lowering, functions)))
      return failure();
  }
  for (LLVM::LLVMFuncOp f : functions)
    if (failed(lowerLeafOps(f, lowering)))
      return failure();

  builder.setInsertionPointToEnd(entry);
  Value status = canFail(functions) ? runtime.tai_rt_failed(builder, loc, frame)
                                    : runtime.i32(builder, loc, 0);
  LLVM::ReturnOp::create(builder, loc, status);
  lowerPreconditions(function, lowering);
  for (LLVM::LLVMFuncOp f : functions)
    modes.setOn(f);
  kernel.erase();
  return success();
}

LogicalResult tai::finishModule(ModuleLowering &lowering) {
  ModuleOp module = lowering.module;
  for (auto function :
       llvm::make_early_inc_range(module.getOps<func::FuncOp>()))
    if (lowering.functions.contains(function) &&
        failed(lowerHostFunction(function, lowering)))
      return failure();
  // After the lowering no op may name a field any more, since the runtime owns
  // the storage of fields.
  WalkResult accesses = module.walk([](Operation *op) {
    if (!isa_and_present<TaiDialect>(op->getDialect()) ||
        !op->getAttrOfType<FlatSymbolRefAttr>("field"))
      return WalkResult::advance();
    op->emitOpError("still names a field; expects tai-lower-struct-for and "
                    "tai-lower-layout to lower it first");
    return WalkResult::interrupt();
  });
  if (accesses.wasInterrupted())
    return failure();
  for (Operation &op : llvm::make_early_inc_range(*module.getBody()))
    if (isa<FieldOp, TreeOp>(op))
      op.erase();
  return success();
}

std::string tai::getEntryPointName(StringRef name) {
  llvm::TargetLibraryInfoImpl library{llvm::Triple("x86_64-unknown-linux-gnu")};
  llvm::LibFunc known;
  bool isTaken = library.getLibFunc(name, known) || name.starts_with("tai_rt_");
  return isTaken ? (name + ".entry").str() : name.str();
}

namespace {
struct ConvertTaiToSCF : tai::impl::ConvertTaiToSCFBase<ConvertTaiToSCF> {
  using Base::Base;

  void runOnOperation() override {
    ModuleOp module = getOperation();
    ModuleLowering lowering(module, debug);
    for (auto kernel : llvm::make_early_inc_range(module.getOps<KernelOp>()))
      if (failed(lowerKernel(kernel, lowering)))
        return signalPassFailure();
    if (failed(finishModule(lowering)))
      return signalPassFailure();
  }
};
} // namespace
