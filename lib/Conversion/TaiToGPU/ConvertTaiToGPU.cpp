//===- ConvertTaiToGPU.cpp - Kernels for a GPU ----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Splits kernels into device functions and host code that launches them; see
// docs/decisions/0010-cuda.md.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "tai/Conversion/Passes.h"
#include "tai/Conversion/TaiToGPU/Offload.h"
#include "tai/Dialect/Tai/IR/Modes.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "tai/Transforms/Utils/IndexMath.h"

namespace mlir::tai {
#define GEN_PASS_DEF_CONVERTTAITOGPU
#include "tai/Conversion/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// True if the function writes through an address derived from `address`.
static bool isWritten(Value address) {
  SmallVector<Value> work{address};
  llvm::DenseSet<Value> seen;
  while (!work.empty()) {
    Value value = work.pop_back_val();
    if (!seen.insert(value).second)
      continue;
    for (OpOperand &use : value.getUses()) {
      Operation *user = use.getOwner();
      if (isa<LLVM::LoadOp, LLVM::ICmpOp>(user))
        continue;
      if (isa<LLVM::GEPOp, arith::SelectOp>(user)) {
        work.append(user->result_begin(), user->result_end());
        continue;
      }
      return true;
    }
  }
  return false;
}

namespace {
/// Lowers one kernel.
class KernelOffload {
public:
  KernelOffload(KernelOp kernel, DeviceLowering &lowering)
      : kernel(kernel), lowering(lowering) {}
  LogicalResult run();

private:
  LogicalResult prepareLoops();
  void replaceTreeBases();
  void replaceDrawKeys();
  LogicalResult outlineLoops();

  KernelOp kernel;
  DeviceLowering &lowering;
  LLVM::LLVMFuncOp host;
  Value frame;
};
} // namespace

/// The name of a device function, made an identifier of PTX.
static std::string getFunctionName(StringRef kernel, size_t number) {
  std::string name = kernel.str();
  for (char &c : name)
    if (!llvm::isAlnum(c) && c != '_')
      c = '_';
  return name + "_" + std::to_string(number);
}

LogicalResult KernelOffload::prepareLoops() {
  SmallVector<ParallelForOp> loops;
  host.walk([&](ParallelForOp loop) { loops.push_back(loop); });
  numberDraws(host, {});
  for (ParallelForOp loop : loops) {
    if (loop.isStructFor())
      return loop.emitOpError("runs over a field; expects a box, as "
                              "tai-lower-struct-for makes it");
    if (failed(checkBlockSize(loop)))
      return failure();
    numberDraws(loop, loop);
    if (isDeviceLoop(loop) && failed(prepareSums(loop, frame, lowering)))
      return failure();
  }
  return success();
}

/// Loads the address of each tree once from the frame of the host.
void KernelOffload::replaceTreeBases() {
  RuntimeCalls &runtime = lowering.host.runtime;
  SmallVector<TreeBaseOp> ops;
  host.walk([&](TreeBaseOp op) { ops.push_back(op); });
  llvm::DenseMap<StringAttr, Value> bases;
  for (TreeBaseOp op : ops) {
    StringAttr tree = op.getTreeAttr().getAttr();
    Value &base = bases[tree];
    if (!base) {
      auto builder = OpBuilder::atBlockBegin(&host.getBody().front());
      Location loc = host.getLoc();
      Value trees =
          runtime.frameMember(builder, loc, frame, offsetof(TaiFrame, trees),
                              runtime.getPointerType());
      base = runtime.frameMember(builder, loc, trees,
                                 lowering.host.treeIndex.lookup(tree) *
                                     sizeof(void *),
                                 runtime.getPointerType());
      base.getDefiningOp()->setAttr(kAlignmentAttrName,
                                    builder.getI64IntegerAttr(kTreeAlignment));
    }
    op.getBase().replaceAllUsesWith(base);
    op.erase();
  }
}

/// Gives random draws the seed and the number of the launch as inputs, which
/// device code gets as parameters.
void KernelOffload::replaceDrawKeys() {
  RuntimeCalls &runtime = lowering.host.runtime;
  SmallVector<UnrealizedConversionCastOp> draws;
  host.walk([&](UnrealizedConversionCastOp op) {
    if (isDraw(op))
      draws.push_back(op);
  });
  if (draws.empty())
    return;
  auto builder = OpBuilder::atBlockBegin(&host.getBody().front());
  Location loc = host.getLoc();
  Type i64 = builder.getI64Type();
  Value seed =
      runtime.frameMember(builder, loc, frame, offsetof(TaiFrame, seed), i64);
  Value launch =
      runtime.frameMember(builder, loc, frame, offsetof(TaiFrame, launch), i64);
  for (UnrealizedConversionCastOp draw : draws)
    draw.getInputsMutable().append({seed, launch});
}

LogicalResult KernelOffload::outlineLoops() {
  SmallVector<ParallelForOp> loops;
  host.walk([&](ParallelForOp loop) {
    if (isDeviceLoop(loop))
      loops.push_back(loop);
  });
  for (auto [i, loop] : llvm::enumerate(loops))
    if (failed(outlineLoop(loop, frame, getFunctionName(kernel.getSymName(), i),
                           lowering)))
      return failure();
  return success();
}

LogicalResult KernelOffload::run() {
  Location loc = kernel.getLoc();
  RuntimeCalls &runtime = lowering.host.runtime;
  host = createFunction(
      lowering.host.module, loc, getEntryPointName(kernel.getSymName()),
      IntegerType::get(kernel.getContext(), 32), {runtime.getPointerType()},
      /*isInternal=*/false);
  Block *entry = &host.getBody().front();
  frame = entry->getArgument(0);
  OpBuilder builder = OpBuilder::atBlockEnd(entry);
  Block &body = kernel.getBody().front();
  auto arrayAddress = [&](OpBuilder &b, BlockArgument array, Value address,
                          ValueRange extents) -> Value {
    IndexMath math(b, loc);
    auto type = cast<MemRefType>(array.getType());
    Type storage = getStorageType(type.getElementType());
    Value bytes =
        math.constant(llvm::divideCeil(storage.getIntOrFloatBitWidth(), 8));
    for (Value extent : extents)
      bytes = math.mul(bytes, extent);
    for (int64_t d = extents.size(); d != type.getRank(); ++d)
      bytes = math.mul(bytes, type.getDimSize(d));
    // The kernel is assumed to write the array for now. This is decided later
    // from the array's uses, which are replaced.
    return runtime.tai_rt_device_array(
        b, loc, frame, address, math.toI64(bytes), runtime.i32(b, loc, 1));
  };
  // Countless loops (too many iterations for a device) are found first: once
  // arguments are replaced, extents of arrays look like integer arguments.
  lowering.countless.clear();
  kernel.walk([&](ParallelForOp loop) {
    if (mayBeCountless(loop))
      lowering.countless.insert(loop);
  });
  if (failed(replaceArguments(kernel, frame, builder, runtime, arrayAddress)))
    return failure();
  SmallVector<LLVM::CallOp> arrays(entry->getOps<LLVM::CallOp>());
  // This op marks the start of the kernel: all ops of the kernel follow it.
  auto start = LLVM::ZeroOp::create(builder, loc, runtime.getPointerType());
  entry->getOperations().splice(entry->end(), body.getOperations());
  for (LLVM::CallOp array : arrays) {
    // Arrays without uses are not copied to the device: a kernel without
    // effects has no device code, either.
    if (array.use_empty()) {
      array.erase();
    } else if (!isWritten(array.getResult())) {
      OpBuilder before(array);
      array.setOperand(3, runtime.i32(before, loc, 0));
    }
  }

  if (failed(splitFixedPointLoops(host, frame, lowering)) ||
      failed(splitWideScatters(host, frame, lowering)) ||
      failed(prepareLoops()))
    return failure();
  replaceTreeBases();
  replaceDrawKeys();
  if (failed(offloadSerialCode(host, start, frame, lowering)))
    return failure();
  readLengthsOnDevice(host);
  if (failed(outlineLoops()))
    return failure();

  Operation *ret = entry->getTerminator();
  replaceReturn(ret, ret->getLoc(), frame, builder, runtime);
  fetchHostValues(host, frame, lowering);
  if (failed(lowerLeafOps(host, lowering.host)))
    return failure();
  start.erase();
  builder.setInsertionPointToEnd(entry);
  Value status = runtime.tai_rt_failed(builder, loc, frame);
  LLVM::ReturnOp::create(builder, loc, status);
  lowerPreconditions(host, lowering.host);
  kernel.erase();
  return success();
}

/// Declares in the device module the functions that device code calls, as they
/// are declared for the host.
static void declareCallees(ModuleOp module, gpu::GPUModuleOp kernels) {
  SymbolTable known(kernels), outer(module);
  OpBuilder builder = OpBuilder::atBlockBegin(&kernels.getBodyRegion().front());
  kernels.walk([&](LLVM::CallOp call) {
    std::optional<StringRef> name = call.getCallee();
    if (!name || known.lookup(*name))
      return;
    if (Operation *declaration = outer.lookup(*name))
      known.insert(builder.clone(*declaration));
  });
}

namespace {
struct ConvertTaiToGPU : tai::impl::ConvertTaiToGPUBase<ConvertTaiToGPU> {
  using Base::Base;

  void runOnOperation() override {
    ModuleOp module = getOperation();
    if (llvm::none_of(*module.getBody(),
                      [](Operation &op) { return isTaiCode(&op); }))
      return;
    OpBuilder builder = OpBuilder::atBlockEnd(module.getBody());
    auto kernels =
        gpu::GPUModuleOp::create(builder, module.getLoc(), "kernels");
    SymbolTable(module).insert(kernels);
    module->setAttr(gpu::GPUDialect::getContainerModuleAttrName(),
                    builder.getUnitAttr());
    if (Attribute bits = module->removeAttr(kIndexBitsAttrName))
      kernels->setAttr(kIndexBitsAttrName, bits);
    ModuleLowering host(module, debug);
    ModuleLowering device(module, debug, kernels);
    DeviceLowering lowering(host, device, kernels);
    for (auto kernel : llvm::make_early_inc_range(module.getOps<KernelOp>())) {
      const Modes modes = Modes::of(kernel);
      auto functions = [&] {
        SmallVector<LLVM::LLVMFuncOp> all;
        for (Region *region :
             {&module.getBodyRegion(), &kernels.getBodyRegion()})
          llvm::append_range(all, region->getOps<LLVM::LLVMFuncOp>());
        return all;
      };
      DenseSet<Operation *> known;
      for (LLVM::LLVMFuncOp function : functions())
        known.insert(function);
      if (failed(KernelOffload(kernel, lowering).run()))
        return signalPassFailure();
      // Functions created from here on get the modes of the kernel.
      for (LLVM::LLVMFuncOp function : functions())
        if (!function.isExternal() && !known.contains(function))
          modes.setOn(function);
    }
    declareCallees(module, kernels);
    if (failed(finishModule(host)))
      return signalPassFailure();
  }
};
} // namespace
