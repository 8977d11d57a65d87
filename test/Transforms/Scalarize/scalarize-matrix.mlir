// RUN: tai-opt %s --tai-scalarize | FileCheck %s

tai.tree @t : !tai.root<dense<[i: 8], {v: vector<3xf32>, m: vector<2x2xf32>, n: vector<3x3xf64>}>>
tai.field @v = @t["v"] : vector<3xf32>, rank 1
tai.field @m = @t["m"] : vector<2x2xf32>, rank 1
tai.field @n = @t["n"] : vector<3x3xf64>, rank 1

// Row 0 of the product of the matrix and the vector.
// CHECK-LABEL: tai.kernel @matmul(
//   CHECK-DAG:   %[[A:.+]]:4 = vector.to_elements %arg0
//   CHECK-DAG:   %[[X:.+]]:2 = vector.to_elements %arg1
//       CHECK:   %[[P:.+]] = arith.mulf %[[A]]#0, %[[X]]#0
//       CHECK:   %[[Q:.+]] = arith.mulf %[[A]]#1, %[[X]]#1
//       CHECK:   arith.addf %[[P]], %[[Q]]
tai.kernel @matmul(%a: vector<2x2xf32>, %x: vector<2xf32>) -> vector<2xf32> {
  %0 = tai.matmul %a, %x : (vector<2x2xf32>, vector<2xf32>) -> vector<2xf32>
  tai.return %0 : vector<2xf32>
}

// Integers multiply as integers.
// CHECK-LABEL: tai.kernel @integers(
//       CHECK:   arith.muli
//       CHECK:   arith.addi
tai.kernel @integers(%a: vector<2xi32>, %b: vector<2xi32>) -> i32 {
  %0 = tai.dot %a, %b : vector<2xi32>
  tai.return %0 : i32
}

// Components are scaled by a power of two where the sum of their squares is not
// in the middle of the range.
// CHECK-LABEL: tai.kernel @norm(
//       CHECK:   %[[X:.+]]:3 = vector.to_elements
//       CHECK:   arith.mulf %[[X]]#0, %[[X]]#0
//       CHECK:   arith.mulf %[[X]]#1, %[[X]]#1
//       CHECK:   arith.mulf %[[X]]#2, %[[X]]#2
//       CHECK:   %[[SUM:.+]] = arith.addf
//   CHECK-DAG:   %[[LEAST:.+]] = arith.constant 7.88860905E-31 : f32
//   CHECK-DAG:   %[[GREATEST:.+]] = arith.constant 3.40282347E+38 : f32
//       CHECK:   %[[ABOVE:.+]] = arith.cmpf ole, %[[LEAST]], %[[SUM]]
//       CHECK:   %[[BELOW:.+]] = arith.cmpf ole, %[[SUM]], %[[GREATEST]]
//       CHECK:   %[[IN:.+]] = arith.andi %[[ABOVE]], %[[BELOW]]
//       CHECK:   scf.if %[[IN]]
//  CHECK-NEXT:     math.sqrt %[[SUM]]
//       CHECK:   } else {
//       CHECK:     %[[BY:.+]] = arith.select
//       CHECK:     arith.mulf %[[X]]#0, %[[BY]]
//       CHECK:     math.sqrt
tai.kernel @norm(%x: vector<3xf32>) -> f32 {
  %0 = tai.norm %x : vector<3xf32>
  tai.return %0 : f32
}

// The question can be left out, and needs not be asked of one component.
// CHECK-LABEL: tai.kernel @fast_norm(
//   CHECK-NOT:   scf.if
//       CHECK:   math.sqrt
tai.kernel @fast_norm(%x: vector<3xf32>) -> f32 {
  %0 = tai.norm fast %x : vector<3xf32>
  tai.return %0 : f32
}

// CHECK-LABEL: tai.kernel @length_of_one(
//   CHECK-NOT:   math.sqrt
//       CHECK:   math.absf
tai.kernel @length_of_one(%x: vector<1xf32>) -> f32 {
  %0 = tai.norm %x : vector<1xf32>
  tai.return %0 : f32
}

// CHECK-LABEL: tai.kernel @transpose(
//       CHECK:   %[[A:.+]]:4 = vector.to_elements
//       CHECK:   vector.from_elements %[[A]]#0, %[[A]]#2, %[[A]]#1, %[[A]]#3
tai.kernel @transpose(%a: vector<2x2xf32>) -> vector<2x2xf32> {
  %0 = tai.transpose %a : vector<2x2xf32> -> vector<2x2xf32>
  tai.return %0 : vector<2x2xf32>
}

// 2x2 decompositions have no loop, 3x3 ones sweep.
// CHECK-LABEL: tai.kernel @polar2(
//   CHECK-NOT:   scf.for
//       CHECK:   tai.return
tai.kernel @polar2(%i: index) {
  %0 = tai.load @m[%i] : vector<2x2xf32>
  %r, %s = tai.polar %0 : vector<2x2xf32>
  tai.store %r, @m[%i] : vector<2x2xf32>
  tai.return
}

// CHECK-LABEL: tai.kernel @svd3(
//       CHECK:   %[[SWEEPS:.+]] = arith.constant 7 : index
//       CHECK:   scf.for %{{.+}} = %{{.+}} to %[[SWEEPS]]
//   CHECK-NOT:   vector.
//       CHECK:   tai.return
tai.kernel @svd3(%i: index) {
  %0 = tai.load @n[%i] : vector<3x3xf64>
  %u, %s, %v = tai.svd %0 : vector<3x3xf64>
  tai.store %s, @n[%i] : vector<3x3xf64>
  tai.return
}
