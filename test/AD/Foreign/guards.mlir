// RUN: tai-opt %s --tai-autodiff | FileCheck %s
// RUN: tai-opt %s --tai-autodiff -o - | sed -e 's/tai\.[a-z_]* = @[a-z_]*,* *//' -e 's/tai.differentiate//' \
// RUN:   | mlir-opt-22 --pass-pipeline='builtin.module(convert-scf-to-cf,convert-vector-to-llvm,convert-to-llvm,reconcile-unrealized-casts)' \
// RUN:   | FileCheck %s --check-prefix=LLVM

// The adjoint of a root may be infinite. The test for that is a reduction of the
// vector dialect, which stock passes lower.
// CHECK-LABEL: func.func @roots_grad(
//   CHECK-NOT:   {{ }}tai.
//       CHECK:   vector.reduction <add>, %{{.*}} : vector<4xf64> into f64
//   CHECK-NOT:   {{ }}tai.
//       CHECK:   return
//  LLVM-LABEL: llvm.func @roots_grad(
//        LLVM:   llvm.intr.vector.reduce.fadd
//    LLVM-NOT:   {{ }}tai.
//        LLVM:   llvm.return
func.func @roots(%x: memref<vector<4xf64>>, %y: memref<f64>) attributes {tai.differentiate} {
  %v = memref.load %x[] : memref<vector<4xf64>>
  %s = arith.mulf %v, %v : vector<4xf64>
  %t = vector.shuffle %s, %s [3, 2, 1, 0] : vector<4xf64>, vector<4xf64>
  %r = math.sqrt %t : vector<4xf64>
  %n = vector.reduction <mul>, %r : vector<4xf64> into f64
  memref.store %n, %y[] : memref<f64>
  return
}

// A quotient and a logarithm that are promised to be finite have no zero to
// guard against.
// CHECK-LABEL: func.func @finite_grad(
//   CHECK-NOT:   guard
//       CHECK:   return
func.func @finite(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %a = memref.load %x[] : memref<f64>
  %s = math.log %a fastmath<nnan,ninf> : f64
  %t = arith.divf %s, %a fastmath<nnan,ninf> : f64
  memref.store %t, %y[] : memref<f64>
  return
}

// One flag does not say it.
// CHECK-LABEL: func.func @one_flag_grad(
//       CHECK:   tai.guard
func.func @one_flag(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %a = memref.load %x[] : memref<f64>
  %s = math.log %a fastmath<nnan> : f64
  memref.store %s, %y[] : memref<f64>
  return
}

// A finite root has an infinite slope at zero all the same.
// CHECK-LABEL: func.func @root_grad(
//       CHECK:   tai.guard
func.func @root(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %a = memref.load %x[] : memref<f64>
  %s = math.sqrt %a fastmath<fast> : f64
  memref.store %s, %y[] : memref<f64>
  return
}
