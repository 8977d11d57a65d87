// REQUIRES: plugin
// RUN: mlir-opt-22 %s --load-dialect-plugin=%tai_plugin | FileCheck %s --check-prefix=PARSE
// RUN: mlir-opt-22 %s --load-dialect-plugin=%tai_plugin --load-pass-plugin=%tai_plugin \
// RUN:   --pass-pipeline='builtin.module(tai-to-llvm{deterministic=true})' | FileCheck %s
// RUN: mlir-opt-22 %s --load-dialect-plugin=%tai_plugin --load-pass-plugin=%tai_plugin \
// RUN:   --pass-pipeline='builtin.module(tai-autodiff)' | FileCheck %s --check-prefix=GRAD
// RUN: mlir-opt-22 %s --load-dialect-plugin=%tai_plugin --load-pass-plugin=%tai_plugin \
// RUN:   --pass-pipeline='builtin.module(tai-autodiff,tai-to-llvm)' \
// RUN:   | mlir-translate-22 --mlir-to-llvmir | FileCheck %s --check-prefix=IR

// A stock mlir-opt parses the dialect and runs the pipelines of tai.

// PARSE: tai.kernel @square
// PARSE: tai.parallel_for
// CHECK: llvm.func @square(
// CHECK-NOT: {{[^"]}}tai.
// GRAD: tai.kernel @square_grad
// IR: define i32 @square(
// IR: define i32 @square_grad(

tai.tree @t : !tai.root<dense<[i: 16], {x: f32, gx: f32}>, {loss: f32, gloss: f32}>
tai.field @gx = @t["gx"] : f32, rank 1
tai.field @gloss = @t["gloss"] : f32, rank 0
tai.field @x = @t["x"] : f32, rank 1, adjoint @gx
tai.field @loss = @t["loss"] : f32, rank 0, adjoint @gloss

tai.kernel @square() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    %2 = tai.atomic add %1, @loss[] : f32
  }
  tai.return
}
