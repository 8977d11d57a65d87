//===- embedding.cpp - tai inside another compiler ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Three calls are all that a compiler on MLIR needs: `registerAll` for its
// registry, `buildPipeline` for its pass manager, which takes kernels to the
// LLVM dialect, and its own `run`. This one prints the lowered kernels.
//
//   embedding [file.mlir]     the kernels of a file instead of the one below
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/BuiltinOps.h"
#include "mlir/Parser/Parser.h"
#include "mlir/Pass/PassManager.h"
#include "tai/InitAll.h"

using namespace mlir;

/// A field of 16 numbers, and a kernel that doubles them.
static const char *const program = R"mlir(
  tai.tree @scene : !tai.root<dense<[i: 16], {x: f32}>>
  tai.field @x = @scene["x"] : f32, rank 1
  tai.kernel @double() {
    tai.parallel_for (%i) in @x {
      %value = tai.load @x[%i] : f32
      %twice = arith.addf %value, %value : f32
      tai.store %twice, @x[%i] : f32
    }
    tai.return
  }
)mlir";

int main(int argc, char **argv) {
  DialectRegistry registry;
  tai::registerAll(registry);
  MLIRContext context(registry);

  OwningOpRef<ModuleOp> module =
      argc > 1 ? parseSourceFile<ModuleOp>(argv[1], &context)
               : parseSourceString<ModuleOp>(program, &context);
  if (!module)
    return 1;

  PassManager pm(&context);
  tai::buildPipeline(pm, tai::ToLLVMOptions());
  if (failed(pm.run(*module)))
    return 1;
  module->print(llvm::outs());
  return 0;
}
