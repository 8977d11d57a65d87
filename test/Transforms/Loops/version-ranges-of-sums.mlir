// RUN: tai-opt %s --tai-version-ranges | FileCheck %s
// RUN: tai-opt %s --tai-version-ranges --tai-gather-ranges | FileCheck %s --check-prefix=GATHER

// In a fixed order of sums, additions at indices that follow the iteration have
// an interior: no element gets terms from all iterations.
// CHECK-LABEL: tai.kernel @clamped(
//       CHECK:   scf.if
//       CHECK:     tai.parallel_for
//       CHECK:     memref.atomic_rmw addf %{{.+}}, %{{.+}}[%{{.+}}]
//       CHECK:     tai.parallel_for
// GATHER-LABEL: tai.kernel @clamped(
//       GATHER:   memref.store
tai.kernel @clamped(%g: memref<?xf32>, %y: memref<?xf32>, %n: i32) attributes {modes = {sums = "deterministic"}} {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0 : i32
  %one = arith.constant 1 : i32
  %count = arith.index_cast %n : i32 to index
  %last = arith.subi %n, %one : i32
  tai.parallel_for (%i) = (%c0) to (%count) {
    %k = arith.index_cast %i : index to i32
    %0 = arith.addi %k, %one : i32
    %1 = arith.minsi %0, %last : i32
    %2 = arith.index_cast %1 : i32 to index
    %3 = arith.subi %k, %one : i32
    %4 = arith.maxsi %3, %zero : i32
    %5 = arith.index_cast %4 : i32 to index
    %6 = memref.load %y[%i] : memref<?xf32>
    %7 = memref.atomic_rmw addf %6, %g[%2] : (f32, memref<?xf32>) -> f32
    %8 = memref.atomic_rmw addf %6, %g[%5] : (f32, memref<?xf32>) -> f32
  }
  tai.return
}

// A sum over all iterations keeps its order, and so does one whose element is
// read from memory.
// CHECK-LABEL: tai.kernel @total(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
tai.kernel @total(%g: memref<?xf32>, %y: memref<?xf32>, %n: i32) attributes {modes = {sums = "deterministic"}} {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1 : i32
  %count = arith.index_cast %n : i32 to index
  %last = arith.subi %n, %one : i32
  tai.parallel_for (%i) = (%c0) to (%count) {
    %k = arith.index_cast %i : index to i32
    %0 = arith.addi %k, %one : i32
    %1 = arith.minsi %0, %last : i32
    %2 = arith.index_cast %1 : i32 to index
    %3 = memref.load %y[%2] : memref<?xf32>
    %4 = memref.atomic_rmw addf %3, %g[%c0] : (f32, memref<?xf32>) -> f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @looked_up(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
tai.kernel @looked_up(%g: memref<?xf32>, %y: memref<?xf32>, %p: memref<?xi32>, %n: i32) attributes {modes = {sums = "deterministic"}} {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1 : i32
  %count = arith.index_cast %n : i32 to index
  %last = arith.subi %n, %one : i32
  tai.parallel_for (%i) = (%c0) to (%count) {
    %k = arith.index_cast %i : index to i32
    %0 = arith.addi %k, %one : i32
    %1 = arith.minsi %0, %last : i32
    %2 = arith.index_cast %1 : i32 to index
    %3 = memref.load %y[%2] : memref<?xf32>
    %4 = memref.load %p[%i] : memref<?xi32>
    %5 = arith.index_cast %4 : i32 to index
    %6 = memref.atomic_rmw addf %3, %g[%5] : (f32, memref<?xf32>) -> f32
  }
  tai.return
}
