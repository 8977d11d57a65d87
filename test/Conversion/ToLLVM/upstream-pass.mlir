// REQUIRES: plugin
// RUN: mlir-opt-22 %s --load-dialect-plugin=%tai_plugin --load-pass-plugin=%tai_plugin \
// RUN:   --pass-pipeline='builtin.module(convert-to-llvm)' | FileCheck %s
// RUN: tai-opt %s --convert-to-llvm | FileCheck %s

// Upstream's conversion in a stock mlir-opt. Ops that mark a value for
// differentiation are converted; all else needs one of our passes before.

// CHECK-LABEL: llvm.func @marked(
//  CHECK-SAME:     %[[A:.+]]: f64, %[[B:.+]]: f64)
//       CHECK:   %[[P:.+]] = llvm.fmul %[[A]], %[[B]]
//       CHECK:   llvm.return %[[P]]
func.func @marked(%a: f64, %b: f64) -> f64 {
  %0 = tai.stop_gradient %a : f64
  %1 = arith.addf %a, %b : f64
  %2 = tai.derive_as %b, %1 : f64
  %3 = arith.mulf %0, %2 : f64
  return %3 : f64
}

// CHECK-LABEL: llvm.func @marked_vectors(
//       CHECK:   llvm.fadd %{{.+}}, %{{.+}} : vector<2xf32>
func.func @marked_vectors(%a: vector<2xf32>) -> vector<2xf32> {
  %0 = tai.stop_gradient %a : vector<2xf32>
  %1 = arith.addf %0, %a : vector<2xf32>
  return %1 : vector<2xf32>
}
