//===- AccessGroupsTest.cpp - Groups that serve again ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A context never frees access groups, so the loops of the next module must
// reuse the groups of the previous one. Loops of one module share no groups.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/IR/BuiltinOps.h"
#include "mlir/Parser/Parser.h"
#include "mlir/Pass/PassManager.h"
#include "tai/Conversion/Passes.h"
#include "tai/InitAll.h"
#include "gtest/gtest.h"

using namespace mlir;
using namespace mlir::tai;

using namespace mlir;
using namespace mlir::tai;

static constexpr const char *kModule = R"(
tai.tree @t : !tai.root<dense<[i: 8], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @twice() {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) = (%c0) to (%c8) {
    tai.store %one, @x[%i] : f32
  } {tai.independent}
  tai.parallel_for (%i) = (%c0) to (%c8) {
    tai.store %one, @x[%i] : f32
  } {tai.independent}
  tai.return
}
)";

/// The access groups of all stores after the pass, in order.
static SmallVector<Attribute> lower(PassManager &manager) {
  SmallVector<Attribute> groups;
  auto module = parseSourceString<ModuleOp>(kModule, manager.getContext());
  if (!module || failed(manager.run(*module)))
    return groups;
  module->walk([&](LLVM::StoreOp store) {
    for (Attribute group : store.getAccessGroupsAttr())
      groups.push_back(group);
  });
  return groups;
}

TEST(AccessGroups, ServeTheNextModule) {
  DialectRegistry registry;
  registerAll(registry);
  MLIRContext context(registry);
  context.loadAllAvailableDialects();
  PassManager manager(&context);
  manager.addPass(createLowerLayout());
  SmallVector<Attribute> first = lower(manager);
  ASSERT_EQ(first.size(), 2u);
  EXPECT_NE(first[0], first[1]);
  EXPECT_EQ(lower(manager), first);
}
