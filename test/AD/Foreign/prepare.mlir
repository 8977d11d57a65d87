// RUN: tai-opt %s --tai-prepare-foreign --split-input-file | FileCheck %s

// A view and an op on arrays become accesses of the arrays.
// CHECK-LABEL: func.func @views(
//       CHECK:   memref.subview
//       CHECK:   linalg.map
// CHECK-LABEL: func.func @views_prepared(
//  CHECK-SAME:     %[[X:.+]]: memref<8xf64>, %[[Y:.+]]: memref<4xf64>) attributes {tai.differentiate, tai.prepared_for = @views}
//   CHECK-NOT:   memref.subview
//       CHECK:   scf.for %[[I:.+]] =
//       CHECK:     %[[J:.+]] = arith.addi %[[I]], %{{.+}}
//       CHECK:     memref.load %[[X]][%[[J]]]
//       CHECK:     memref.store %{{.+}}, %[[Y]][%[[I]]]
func.func @views(%x: memref<8xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %v = memref.subview %x[2] [4] [1] : memref<8xf64> to memref<4xf64, strided<[1], offset: 2>>
  linalg.map { math.sin } ins(%v : memref<4xf64, strided<[1], offset: 2>>) outs(%y : memref<4xf64>)
  return
}

// A function that does not ask stays as it is, and so does one of ops that have
// derivatives.
// CHECK-LABEL: func.func @other(
//       CHECK:   linalg.map
//   CHECK-NOT: prepared
func.func @other(%x: memref<4xf64>, %y: memref<4xf64>) {
  linalg.map { math.sin } ins(%x : memref<4xf64>) outs(%y : memref<4xf64>)
  return
}
func.func @simple(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %a = memref.load %x[%c0] : memref<4xf64>
  memref.store %a, %y[%c0] : memref<4xf64>
  return
}

// -----

// Loops carry numbers in place of arrays.
// CHECK-LABEL: func.func @swap_prepared(
//       CHECK:   scf.for {{.+}} iter_args(%[[FROM:.+]] = %{{.+}}, %[[TO:.+]] = %{{.+}}) -> (index, index)
//       CHECK:     arith.cmpi eq, %[[FROM]]
//       CHECK:     scf.if
//       CHECK:       memref.load
//       CHECK:       memref.load
//       CHECK:     scf.yield %[[TO]], %[[FROM]] : index, index
func.func @swap(%a: memref<4xf64>, %b: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %r:2 = scf.for %t = %c0 to %c3 step %c1 iter_args(%from = %a, %to = %b) -> (memref<4xf64>, memref<4xf64>) {
    %u = memref.load %from[%c0] : memref<4xf64>
    %v = math.sin %u : f64
    memref.store %v, %to[%c0] : memref<4xf64>
    scf.yield %to, %from : memref<4xf64>, memref<4xf64>
  }
  return
}

// -----

// A print and an assertion are left out; tensors become memrefs, with one more
// for the result.
// CHECK-LABEL: func.func @tensors_prepared(
//  CHECK-SAME:     %{{.+}}: memref<4xf64>, %{{.+}}: memref<f64>)
//   CHECK-NOT:   vector.print
//   CHECK-NOT:   cf.assert
//       CHECK:   return
func.func @tensors(%x: tensor<4xf64>) -> f64 attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %true = arith.constant true
  %a = tensor.extract %x[%c0] : tensor<4xf64>
  vector.print %a : f64
  cf.assert %true, "never"
  return %a : f64
}

// -----

// An array that each iteration makes is copied to one from before the loop.
// CHECK-LABEL: func.func @carried_prepared(
//       CHECK:   %[[KEPT:.+]] = memref.alloc() : memref<4xf64>
//       CHECK:   scf.for
//       CHECK:     %[[OWN:.+]] = memref.alloc() : memref<4xf64>
//       CHECK:     memref.load %[[KEPT]]
//       CHECK:     memref.load %[[OWN]]
//       CHECK:     memref.store %{{.+}}, %[[KEPT]]
//       CHECK:   memref.load %[[KEPT]]
func.func @carried(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %r = scf.for %i = %c0 to %c4 step %c1 iter_args(%a = %x) -> memref<4xf64> {
    %b = memref.alloc() : memref<4xf64>
    %0 = memref.load %a[%c0] : memref<4xf64>
    memref.store %0, %b[%c0] : memref<4xf64>
    scf.yield %b : memref<4xf64>
  }
  %1 = memref.load %r[%c0] : memref<4xf64>
  memref.store %1, %y[%c0] : memref<4xf64>
  return
}
