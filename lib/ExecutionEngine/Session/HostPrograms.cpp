//===- HostPrograms.cpp - Modules of host functions -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "HostPrograms.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "tai/Dialect/Check/IR/Check.h"
#include "tai/Dialect/Tai/IR/Ownership.h"

using namespace mlir;
using namespace mlir::tai;

/// Reduces kernels to their signatures: the host calls them through the
/// runtime.
static void stubKernels(ModuleOp module) {
  for (KernelOp kernel : module.getOps<KernelOp>()) {
    kernel.removeAdjointAttr();
    Block &block = kernel.getBody().front();
    block.dropAllReferences();
    block.getOperations().clear();
    OpBuilder builder = OpBuilder::atBlockEnd(&block);
    SmallVector<Value> zeros;
    for (Type type : kernel.getResultTypes())
      zeros.push_back(arith::ConstantOp::create(
          builder, kernel.getLoc(),
          cast<TypedAttr>(builder.getZeroAttr(type))));
    ReturnOp::create(builder, kernel.getLoc(), zeros);
  }
}

/// Drops operations that use nothing of tai and do not belong to the program
/// `entry`.
static void keepReachable(ModuleOp module, StringRef entry) {
  // The program is marked to be lowered even if it contains no op of the
  // dialect tai.
  if (auto program = module.lookupSymbol<func::FuncOp>(entry))
    markLowered(program);
  llvm::SetVector<Operation *> needed = collectLowered(module);
  for (size_t i = 0; i < needed.size(); ++i)
    needed[i]->walk([&](Operation *op) {
      op->getAttrDictionary().walk([&](SymbolRefAttr symbol) {
        if (Operation *named = module.lookupSymbol(symbol.getRootReference()))
          needed.insert(named);
      });
    });
  for (Operation &op : llvm::make_early_inc_range(*module.getBody()))
    if (!needed.contains(&op))
      op.erase();
}

OwningOpRef<ModuleOp> mlir::tai::makeHostModule(ModuleOp module,
                                                StringRef entry) {
  OwningOpRef<ModuleOp> host = module.clone();
  upgradeFormerChecks(*host);
  // Kernels are reduced to signatures first, so that helpers that only kernels
  // call are dropped.
  stubKernels(*host);
  keepReachable(*host, entry);
  return host;
}

bool mlir::tai::usesFields(ModuleOp module) {
  SymbolTable symbols(module);
  bool found = false;
  for (func::FuncOp function : module.getOps<func::FuncOp>())
    function.walk([&](Operation *op) {
      if (isa<LaunchOp>(op) || op->hasTrait<RecordsLaunches>())
        return;
      op->getAttrDictionary().walk([&](SymbolRefAttr name) {
        found |= isa_and_nonnull<FieldOp, TreeOp>(
            symbols.lookup(name.getRootReference()));
      });
    });
  return found;
}
