// RUN: tai-opt %s --tai-autodiff-forward --mem2reg --canonicalize | FileCheck %s

// Numbers have tangents by their positions: one argument for each that is named, and one result at the end.
// CHECK-LABEL: func.func @numbers_fwd(
//  CHECK-SAME:     %[[X:.+]]: f64, %[[N:.+]]: i32, %[[Y:.+]]: f64, %[[DX:.+]]: f64) -> (f64, i32, f64)
//   CHECK-NOT:   memref
//       CHECK:   %[[P:.+]] = arith.mulf %[[X]], %[[Y]]
//   CHECK-DAG:   %[[DP:.+]] = arith.mulf %[[DX]], %[[Y]]
//       CHECK:   return %[[P]], %[[N]], %[[DP]]
func.func @numbers(%x: f64, %n: i32, %y: f64) -> (f64, i32) attributes {tai.differentiate, tai.gradients = array<i64: 0, 3>} {
  %p = arith.mulf %x, %y : f64
  return %p, %n : f64, i32
}

// An array that is not named has a tangent of zeros; one that is named is changed with its tangent.
// CHECK-LABEL: func.func @arrays_fwd(
//  CHECK-SAME:     %[[X:.+]]: memref<3xf64>, %[[Y:.+]]: memref<3xf64>, %[[S:.+]]: f64, %[[DX:.+]]: memref<3xf64>, %[[DS:.+]]: f64) {
//       CHECK:   %[[DY:.+]] = memref.alloc() : memref<3xf64>
//       CHECK:   memref.store %{{.+}}, %[[DX]][%{{.+}}] : memref<3xf64>
//       CHECK:   memref.dealloc %[[DY]]
//  CHECK-NEXT:   return
func.func @arrays(%x: memref<3xf64>, %y: memref<3xf64>, %s: f64) attributes {tai.differentiate, tai.gradients = array<i64: 0, 2>} {
  %c1 = arith.constant 1 : index
  %a = memref.load %y[%c1] : memref<3xf64>
  %b = arith.mulf %a, %s : f64
  memref.store %b, %x[%c1] : memref<3xf64>
  return
}
