// RUN: tai-opt %s --tai-make-adjoint --canonicalize | FileCheck %s

// Whether an adjoint is accumulated by a plain sum is asked of all parallel loops
// around it: an element that only the inner index tells apart is met by every
// iteration of the outer loop.
// CHECK-LABEL: func.func @inner_index_grad(
//  CHECK-SAME:     %[[X:.+]]: memref<4xf64>, %[[Y:.+]]: memref<4x4xf64>, %[[DX:.+]]: memref<4xf64>, %[[DY:.+]]: memref<4x4xf64>)
//       CHECK:   memref.atomic_rmw addf %{{.+}}, %[[DX]]
//       CHECK:   return
func.func @inner_index(%x: memref<4xf64>, %y: memref<4x4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    scf.parallel (%j) = (%c0) to (%c4) step (%c1) {
      %0 = memref.load %x[%j] : memref<4xf64>
      %1 = arith.mulf %0, %0 : f64
      memref.store %1, %y[%i, %j] : memref<4x4xf64>
    }
  }
  return
}

// Both indices together tell all apart.
// CHECK-LABEL: func.func @both_indices_grad(
//   CHECK-NOT:   memref.atomic_rmw
//       CHECK:   return
func.func @both_indices(%x: memref<4x4xf64>, %y: memref<4x4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    scf.parallel (%j) = (%c0) to (%c4) step (%c1) {
      %0 = memref.load %x[%j, %i] : memref<4x4xf64>
      %1 = arith.mulf %0, %0 : f64
      memref.store %1, %y[%i, %j] : memref<4x4xf64>
    }
  }
  return
}

// One loop reads rows, the next one columns: iterations of the outer loop meet.
// CHECK-LABEL: func.func @rows_and_columns_grad(
//  CHECK-SAME:     %{{.+}}, %{{.+}}, %{{.+}}, %[[DX:[a-z0-9]+]]: memref<4x4xf64>, %{{[a-z0-9]+}}: memref<4x4xf64>, %{{[a-z0-9]+}}: memref<4x4xf64>)
//       CHECK:   memref.atomic_rmw addf %{{.+}}, %[[DX]]
//       CHECK:   memref.atomic_rmw addf %{{.+}}, %[[DX]]
//       CHECK:   return
func.func @rows_and_columns(%x: memref<4x4xf64>, %y: memref<4x4xf64>, %z: memref<4x4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    scf.parallel (%j) = (%c0) to (%c4) step (%c1) {
      %0 = memref.load %x[%i, %j] : memref<4x4xf64>
      %1 = arith.mulf %0, %0 : f64
      memref.store %1, %y[%i, %j] : memref<4x4xf64>
    }
    scf.parallel (%j) = (%c0) to (%c4) step (%c1) {
      %0 = memref.load %x[%j, %i] : memref<4x4xf64>
      %1 = arith.mulf %0, %0 : f64
      memref.store %1, %z[%i, %j] : memref<4x4xf64>
    }
  }
  return
}

// The same of fields, in a kernel.
// CHECK-LABEL: tai.kernel @fields_grad(
//       CHECK:   tai.atomic add %{{.+}}, @gx[%{{.+}}] :
//       CHECK:   tai.return
// CHECK-LABEL: tai.kernel @in_order_grad(
//       CHECK:   tai.atomic add %{{.+}}, @gx[%{{.+}}] exclusive :
//       CHECK:   tai.return
tai.tree @t : !tai.root<dense<[i: 4], {x: f64, gx: f64}>, dense<[i: 4, j: 4], {y: f64, gy: f64}>>
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @gy = @t["gy"] : f64, rank 2
tai.field @x = @t["x"] : f64, rank 1, adjoint @gx
tai.field @y = @t["y"] : f64, rank 2, adjoint @gy
tai.kernel @fields() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) = (%c0) to (%c4) {
    scf.parallel (%j) = (%c0) to (%c4) step (%c1) {
      %0 = tai.load @x[%j] : f64
      %1 = arith.mulf %0, %0 : f64
      tai.store %1, @y[%i, %j] : f64
    }
  }
  tai.return
}
// The outer loop on one thread leaves the inner one alone to meet itself.
tai.kernel @in_order() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) = (%c0) to (%c4) serialize {
    scf.parallel (%j) = (%c0) to (%c4) step (%c1) {
      %0 = tai.load @x[%j] : f64
      %1 = arith.mulf %0, %0 : f64
      tai.store %1, @y[%i, %j] : f64
    }
  }
  tai.return
}
