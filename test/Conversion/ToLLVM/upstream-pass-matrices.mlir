// REQUIRES: plugin
// RUN: mlir-opt-22 %s --load-dialect-plugin=%tai_plugin --load-pass-plugin=%tai_plugin \
// RUN:   --pass-pipeline='builtin.module(func.func(tai-scalarize),convert-vector-to-llvm,convert-to-llvm,reconcile-unrealized-casts)' \
// RUN:   | mlir-translate-22 --mlir-to-llvmir | FileCheck %s
// RUN: mlir-opt-22 %s --load-dialect-plugin=%tai_plugin --load-pass-plugin=%tai_plugin \
// RUN:   --pass-pipeline='builtin.module(func.func(tai-eliminate-locals),tai-expand-gradients,func.func(tai-scalarize),convert-vector-to-llvm,convert-to-llvm,reconcile-unrealized-casts)' \
// RUN:   | mlir-translate-22 --mlir-to-llvmir | FileCheck %s

// The pass that the refusal names comes before upstream's conversion.

// CHECK-LABEL: define float @length(
//       CHECK:   fmul float
func.func @length(%a: vector<3xf32>) -> f32 {
  %0 = tai.dot %a, %a : vector<3xf32>
  return %0 : f32
}
