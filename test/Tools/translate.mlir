// RUN: tai-translate --mlir-to-llvmir %s | FileCheck %s

// CHECK: define float @one()
llvm.func @one() -> f32 {
  %0 = llvm.mlir.constant(1.0 : f32) : f32
  llvm.return %0 : f32
}
