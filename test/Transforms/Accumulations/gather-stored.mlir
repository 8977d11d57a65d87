// RUN: tai-opt %s --tai-scatter-to-gather | FileCheck %s

// Additions that depend on values that the loop takes from the same field stay
// where they are: another iteration would find zero there, or not.

!t = !tai.root<dense<[i: 2, j: 16], {g: f32}>>
tai.tree @t : !t
tai.field @g = @t["g"] : f32, rank 2

// CHECK-LABEL: tai.kernel @takes
//       CHECK:   tai.load
//       CHECK:   tai.store
//  CHECK-NEXT:   tai.atomic add
//  CHECK-NEXT: }
tai.kernel @takes() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c16 = arith.constant 16 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%j) = (%c0) to (%c16) {
    %k = arith.addi %j, %c1 : index
    %0 = tai.load @g[%c1, %j] : f32
    tai.store %zero, @g[%c1, %j] : f32
    tai.atomic add %0, @g[%c0, %k] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @reads
//       CHECK:   tai.atomic add %{{.+}}, @g[%{{.+}}] exclusive
tai.kernel @reads() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c16 = arith.constant 16 : index
  tai.parallel_for (%j) = (%c0) to (%c16) {
    %k = arith.addi %j, %c1 : index
    %0 = tai.load @g[%c1, %j] : f32
    tai.atomic add %0, @g[%c0, %k] : f32
  }
  tai.return
}
