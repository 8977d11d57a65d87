// RUN: tai-opt %s --tai-autodiff --split-input-file --verify-diagnostics | FileCheck %s
// RUN: tai-opt %s --tai-autodiff-forward --split-input-file | FileCheck %s --check-prefix=FORWARD

// Threads are iterations of a parallel loop in the derivative. Dimensions of
// size one go, and one thread is no loop.
// CHECK-LABEL: func.func @two_dims(
//       CHECK:   gpu.launch
// CHECK-LABEL: func.func @two_dims_grad(
//   CHECK-NOT:   gpu.
//       CHECK:   scf.parallel (%[[B:.+]], %[[T:.+]]) = (%{{.+}}, %{{.+}}) to (%arg{{.+}}, %{{.+}})
//       CHECK:   %[[O:.+]] = arith.muli %[[B]], %{{.+}}
//       CHECK:   arith.addi %[[O]], %[[T]]
// FORWARD-LABEL: func.func @two_dims_fwd(
//   FORWARD-NOT:   gpu.
//       FORWARD:   scf.parallel
func.func @two_dims(%x: memref<?xf64>, %y: memref<?xf64>, %n: index) attributes {tai.differentiate} {
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  gpu.launch blocks(%bx, %by, %bz) in (%gx = %n, %gy = %c1, %gz = %c1)
             threads(%tx, %ty, %tz) in (%sx = %c4, %sy = %c1, %sz = %c1) {
    %o = arith.muli %bx, %sx : index
    %i = arith.addi %o, %tx : index
    %a = memref.load %x[%i] : memref<?xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %y[%i] : memref<?xf64>
    gpu.terminator
  }
  return
}

// -----

// CHECK-LABEL: func.func @one_thread_grad(
//   CHECK-NOT:   gpu.
//   CHECK-NOT:   scf.parallel
func.func @one_thread(%x: memref<2xf64>, %y: memref<2xf64>) attributes {tai.differentiate} {
  %c1 = arith.constant 1 : index
  gpu.launch blocks(%bx, %by, %bz) in (%gx = %c1, %gy = %c1, %gz = %c1)
             threads(%tx, %ty, %tz) in (%sx = %c1, %sy = %c1, %sz = %c1) {
    %a = memref.load %x[%tx] : memref<2xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %y[%tx] : memref<2xf64>
    gpu.terminator
  }
  return
}

// -----

// Threads that wait for each other are no parallel loop. The tangent goes along
// with the values.
// FORWARD-LABEL: func.func @barrier_fwd(
//       FORWARD:   gpu.launch
//       FORWARD:   gpu.barrier
func.func @barrier(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  // expected-error @+2 {{'gpu.launch' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{compute the value from differentiable ops}}
  gpu.launch blocks(%bx, %by, %bz) in (%gx = %c1, %gy = %c1, %gz = %c1)
             threads(%tx, %ty, %tz) in (%sx = %c4, %sy = %c1, %sz = %c1) {
    %a = memref.load %x[%tx] : memref<4xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %y[%tx] : memref<4xf64>
    gpu.barrier
    %r = arith.subi %c3, %tx : index
    %c = memref.load %y[%r] : memref<4xf64>
    memref.store %c, %x[%tx] : memref<4xf64>
    gpu.terminator
  }
  return
}
