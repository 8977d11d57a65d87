// RUN: tai-opt %s --tai-autodiff | FileCheck %s
// RUN: tai-opt %s --tai-autodiff --tai-to-nvvm | FileCheck %s
// RUN: tai-opt %s --tai-simplify-huge-bodies=min-ops=1 | FileCheck %s

// A dimension that no memref has is undefined where it is executed, and stays.
// A pattern of the gpu dialect read the shape there, 32 GiB behind it.

gpu.module @loads_the_dialect {
}

// CHECK-LABEL: func.func @negative
//       CHECK:   %[[C:.+]] = arith.constant -1 : index
//       CHECK:   memref.dim %{{.+}}, %[[C]]
func.func @negative(%x: memref<?xf64>, %y: memref<?xf64>)
    attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %negative = arith.constant -1 : index
  %n = memref.dim %x, %negative : memref<?xf64>
  scf.parallel (%i) = (%c0) to (%n) step (%c1) {
    %a = memref.load %x[%i] : memref<?xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %y[%i] : memref<?xf64>
  }
  return
}

// CHECK-LABEL: func.func @in_a_loop
//       CHECK:   %[[C:.+]] = arith.constant -1 : index
//       CHECK:   memref.dim %{{.+}}, %[[C]]
func.func @in_a_loop(%x: memref<?xf64>, %y: memref<?xindex>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %negative = arith.constant -1 : index
    %n = memref.dim %x, %negative : memref<?xf64>
    memref.store %n, %y[%i] : memref<?xindex>
  }
  return
}
