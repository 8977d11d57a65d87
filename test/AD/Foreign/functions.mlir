// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s
// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse \
// RUN:   | mlir-opt-22 --convert-scf-to-cf --convert-math-to-llvm --expand-strided-metadata \
// RUN:       --finalize-memref-to-llvm --convert-arith-to-llvm --convert-func-to-llvm \
// RUN:       --convert-cf-to-llvm --reconcile-unrealized-casts \
// RUN:   | mlir-runner -e main --entry-point-result=void \
// RUN:       --shared-libs=%llvm_lib/libmlir_c_runner_utils.so \
// RUN:   | FileCheck %s --check-prefix=VALUES

// A function of memrefs, with no tai type in it: each float memref gets a second
// one for its adjoint, at the end. Shared contributions of iterations are added
// atomically, their own are plain additions. A sum over a parallel loop hands
// its adjoint to every iteration.
// CHECK-LABEL: func.func @f(
//  CHECK-SAME:     tai.adjoint = @f_grad
// CHECK-LABEL: func.func @f_grad(
//  CHECK-SAME:     %[[X:[a-z0-9]+]]: memref<?xf64>, %[[W:[a-z0-9]+]]: memref<4xf64>, %[[Y:[a-z0-9]+]]: memref<?xf64>, %[[OUT:[a-z0-9]+]]: memref<f64>
//  CHECK-SAME:     %[[XG:[a-z0-9]+]]: memref<?xf64>, %[[WG:[a-z0-9]+]]: memref<4xf64>, %[[YG:[a-z0-9]+]]: memref<?xf64>, %[[OUTG:[a-z0-9]+]]: memref<f64>) {
//       CHECK:   %[[G:.+]] = memref.load %[[OUTG]][]
//       CHECK:   scf.parallel (%[[I:.+]]) =
//       CHECK:     %[[YI:.+]] = memref.load %[[Y]][%[[I]]]
//       CHECK:     %[[GY:.+]] = arith.mulf %[[G]], %[[YI]]
//       CHECK:     memref.store %{{.+}}, %[[YG]][%[[I]]]
//       CHECK:   scf.parallel (%[[I:.+]]) =
//       CHECK:     memref.load %[[YG]][%[[I]]]
//       CHECK:     scf.for
//       CHECK:       memref.atomic_rmw addf %{{.+}}, %[[WG]][%{{.+}}]
//   CHECK-NOT:       memref.atomic_rmw
//       CHECK:     memref.store %{{.+}}, %[[XG]][%[[I]]]
//       CHECK:   return
func.func @f(%x: memref<?xf64>, %w: memref<4xf64>, %y: memref<?xf64>,
             %out: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %zero = arith.constant 0.0 : f64
  %n = memref.dim %x, %c0 : memref<?xf64>
  scf.parallel (%i) = (%c0) to (%n) step (%c1) {
    %a = memref.load %x[%i] : memref<?xf64>
    %r = scf.for %j = %c0 to %c4 step %c1 iter_args(%s = %zero) -> f64 {
      %b = memref.load %w[%j] : memref<4xf64>
      %m = arith.mulf %a, %b : f64
      %q = math.sin %m : f64
      %t = arith.addf %s, %q : f64
      scf.yield %t : f64
    }
    memref.store %r, %y[%i] : memref<?xf64>
  }
  %sum = scf.parallel (%i) = (%c0) to (%n) step (%c1) init (%zero) -> f64 {
    %b = memref.load %y[%i] : memref<?xf64>
    %m = arith.mulf %b, %b : f64
    scf.reduce(%m : f64) {
    ^bb0(%l: f64, %r: f64):
      %s = arith.addf %l, %r : f64
      scf.reduce.return %s : f64
    }
  }
  memref.store %sum, %out[] : memref<f64>
  return
}

// An integer array has no adjoint, and a function that does not ask is left
// alone.
// CHECK-LABEL: func.func @gather_grad(
//  CHECK-SAME:     %{{.+}}: memref<?xf32>, %{{.+}}: memref<?xi32>, %{{.+}}: memref<?xf32>, %[[XG:.+]]: memref<?xf32>, %{{.+}}: memref<?xf32>) {
//       CHECK:   memref.atomic_rmw addf %{{.+}}, %[[XG]]
func.func @gather(%x: memref<?xf32>, %at: memref<?xi32>, %y: memref<?xf32>)
    attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %n = memref.dim %y, %c0 : memref<?xf32>
  scf.parallel (%i) = (%c0) to (%n) step (%c1) {
    %k = memref.load %at[%i] : memref<?xi32>
    %j = arith.index_cast %k : i32 to index
    %v = memref.load %x[%j] : memref<?xf32>
    memref.store %v, %y[%i] : memref<?xf32>
  }
  return
}

// The adjoint takes the place of its declaration.
func.func private @f_grad(memref<?xf64>, memref<4xf64>, memref<?xf64>,
    memref<f64>, memref<?xf64>, memref<4xf64>, memref<?xf64>, memref<f64>)

// CHECK-NOT: @main_grad
func.func @main() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %one = arith.constant 1.0 : f64
  %zero = arith.constant 0.0 : f64
  %half = arith.constant 0.5 : f64
  %x = memref.alloc(%c3) : memref<?xf64>
  %y = memref.alloc(%c3) : memref<?xf64>
  %xg = memref.alloc(%c3) : memref<?xf64>
  %yg = memref.alloc(%c3) : memref<?xf64>
  %w = memref.alloc() : memref<4xf64>
  %wg = memref.alloc() : memref<4xf64>
  %out = memref.alloc() : memref<f64>
  %outg = memref.alloc() : memref<f64>
  scf.for %i = %c0 to %c3 step %c1 {
    %k = arith.index_cast %i : index to i64
    %v = arith.sitofp %k : i64 to f64
    %u = arith.mulf %v, %half : f64
    %z = arith.addf %u, %one : f64
    memref.store %z, %x[%i] : memref<?xf64>
    memref.store %zero, %xg[%i] : memref<?xf64>
    memref.store %zero, %yg[%i] : memref<?xf64>
  }
  scf.for %i = %c0 to %c4 step %c1 {
    %k = arith.index_cast %i : index to i64
    %v = arith.sitofp %k : i64 to f64
    %u = arith.mulf %v, %half : f64
    memref.store %u, %w[%i] : memref<4xf64>
    memref.store %zero, %wg[%i] : memref<4xf64>
  }
  memref.store %one, %outg[] : memref<f64>
  func.call @f(%x, %w, %y, %out) : (memref<?xf64>, memref<4xf64>, memref<?xf64>, memref<f64>) -> ()
  func.call @f_grad(%x, %w, %y, %out, %xg, %wg, %yg, %outg) : (memref<?xf64>, memref<4xf64>, memref<?xf64>, memref<f64>, memref<?xf64>, memref<4xf64>, memref<?xf64>, memref<f64>) -> ()
  // With y_i = sum_j sin(x_i w_j): dx_i = 2 y_i sum_j w_j cos(x_i w_j), and
  // dw_j = sum_i 2 y_i x_i cos(x_i w_j).
  // VALUES: 5.03183
  // VALUES-NEXT: -2.48511
  // VALUES-NEXT: -6.17128
  scf.for %i = %c0 to %c3 step %c1 {
    %v = memref.load %xg[%i] : memref<?xf64>
    func.call @printF64(%v) : (f64) -> ()
    func.call @printNewline() : () -> ()
  }
  // VALUES-NEXT: 19.576
  // VALUES-NEXT: 13.5517
  // VALUES-NEXT: -0.122501
  // VALUES-NEXT: -11.7945
  scf.for %i = %c0 to %c4 step %c1 {
    %v = memref.load %wg[%i] : memref<4xf64>
    func.call @printF64(%v) : (f64) -> ()
    func.call @printNewline() : () -> ()
  }
  return
}
func.func private @printF64(f64)
func.func private @printNewline()
