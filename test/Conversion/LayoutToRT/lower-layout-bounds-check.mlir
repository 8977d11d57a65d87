// RUN: tai-opt %s --tai-lower-layout=bounds-check=true | FileCheck %s
// RUN: tai-opt %s --tai-lower-layout | FileCheck %s --check-prefix=OFF

tai.tree @t : !tai.root<dense<[i: 4, j: 8], {x: f32, v: vector<3xf32>}>>
tai.field @x = @t["x"] : f32, rank 2, offset [1, 0]
tai.field @v = @t["v"] : vector<3xf32>, rank 2

// Negative indices are large ones: one comparison for each dimension. A load
// outside yields zero.
// CHECK-LABEL: tai.kernel @read(
//  CHECK-SAME:     %[[I:.+]]: index, %[[J:.+]]: index
//       CHECK:   %[[I0:.+]] = arith.subi %[[I]]
//       CHECK:   %[[A:.+]] = arith.cmpi ult, %[[I0]], %{{.+}}
//       CHECK:   %[[B:.+]] = arith.cmpi ult, %[[J]], %{{.+}}
//       CHECK:   %[[OK:.+]] = arith.andi %[[A]], %[[B]]
//       CHECK:   tai.assert %[[OK]], "index [{}, {}] is out of range for field '@x' of shape [4, 8] from [1, 0]"(%[[I]], %[[J]])
//  CHECK-SAME:     {failure = 2 : i32}
//       CHECK:   %[[R:.+]] = scf.if %[[OK]] -> (f32) {
//       CHECK:     llvm.load
//       CHECK:   } else {
//       CHECK:     %[[ZERO:.+]] = arith.constant 0.0
//       CHECK:     scf.yield %[[ZERO]]
//       CHECK:   tai.return %[[R]]
//   OFF-LABEL: tai.kernel @read
//     OFF-NOT:   tai.assert
tai.kernel @read(%i: index, %j: index) -> f32 {
  %0 = tai.load @x[%i, %j] : f32
  tai.return %0 : f32
}

// A component that is not constant is checked too; a store outside is skipped.
// CHECK-LABEL: tai.kernel @write(
//       CHECK:   tai.assert {{.+}} for field '@v' of shape [4, 8]"
//       CHECK:   tai.assert {{.+}} for an element of shape [3] of field '@v'"
//       CHECK:   scf.if
//       CHECK:     llvm.store
tai.kernel @write(%i: index, %c: index, %x: f32) {
  tai.store %x, @v[%i, %i] component [%c] : f32
  tai.return
}

// CHECK-LABEL: tai.kernel @array(
//  CHECK-SAME:     %[[M:[^:]+]]: memref<?xf32>, %[[I:[^:]+]]: index
//       CHECK:   %[[N:.+]] = memref.dim %[[M]]
//       CHECK:   tai.assert {{.+}} for an array of f32 of shape [{}]"(%[[I]], %[[N]])
tai.kernel @array(%m: memref<?xf32>, %i: index, %x: f32) {
  memref.store %x, %m[%i] : memref<?xf32>
  tai.return
}

// Indices known to be in range are not checked again.
// CHECK-LABEL: tai.kernel @known(
//   CHECK-NOT:   tai.assert
//       CHECK:   tai.return
tai.kernel @known(%m: memref<?xf32>, %i: index, %c: index, %x: f32) {
  tai.store %x, @v[%i, %i] component [%c] {tai.in_range} : f32
  memref.store %x, %m[%i] {tai.in_range} : memref<?xf32>
  tai.return
}

// A float that no integer stands for may become any integer.
// CHECK-LABEL: tai.kernel @float(
//  CHECK-SAME:     %[[M:[^:]+]]: memref<?xf32>, %[[F:[^:]+]]: f32
//       CHECK:   %[[N:.+]] = memref.dim %[[M]]
//       CHECK:   %[[LOW:.+]] = arith.constant -2.14748365E+9 : f32
//       CHECK:   %[[A:.+]] = arith.cmpf oge, %[[F]], %[[LOW]]
//       CHECK:   %[[HIGH:.+]] = arith.constant 2.14748365E+9 : f32
//       CHECK:   %[[B:.+]] = arith.cmpf olt, %[[F]], %[[HIGH]]
//       CHECK:   %[[OK:.+]] = arith.andi %[[A]], %[[B]]
//       CHECK:   tai.assert %[[OK]], "{} is no index: as an integer it is out of range for an array of f32 of shape [{}]"(%[[F]], %[[N]])
tai.kernel @float(%m: memref<?xf32>, %f: f32, %x: f32) {
  %one = arith.constant 1 : i32
  %w = arith.fptosi %f : f32 to i32
  %n = arith.addi %w, %one : i32
  %i = arith.index_cast %n : i32 to index
  memref.store %x, %m[%i] : memref<?xf32>
  tai.return
}
