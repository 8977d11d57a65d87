//===- other-opt.cpp - An mlir-opt of somebody else -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// It has tai's dialects and passes, and a pass of its own over tai's ops, which
// adds the fields that a kernel writes to its name.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Pass/Pass.h"
#include "mlir/Tools/mlir-opt/MlirOptMain.h"
#include "tai-c/Version.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/InitAll.h"

using namespace mlir;

static_assert(TAI_VERSION_NUMBER >= TAI_MAKE_VERSION(0, 2, 0));

namespace {
struct NameStores : PassWrapper<NameStores, OperationPass<ModuleOp>> {
  MLIR_DEFINE_EXPLICIT_INTERNAL_INLINE_TYPE_ID(NameStores)
  StringRef getArgument() const override { return "name-stores"; }
  void runOnOperation() override {
    getOperation().walk([](tai::KernelOp kernel) {
      std::string name = kernel.getSymName().str();
      kernel.walk(
          [&](tai::StoreOp store) { name += "_to_" + store.getField().str(); });
      kernel.setSymName(name);
    });
  }
};
} // namespace

int main(int argc, char **argv) {
  DialectRegistry registry;
  registry.insert<arith::ArithDialect, func::FuncDialect>();
  tai::registerAll(registry);
  tai::registerAllPasses();
  PassRegistration<NameStores>();
  return failed(MlirOptMain(argc, argv, "another compiler\n", registry));
}
