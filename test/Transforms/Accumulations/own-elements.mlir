// RUN: tai-opt %s --tai-relax-atomics | FileCheck %s
// RUN: tai-opt %s --tai-fix-sum-order --tai-relax-atomics | FileCheck %s

// Updates at several places of a field that no two iterations share.
!t = !tai.root<dense<[i: 1000000], {x: f32}>, dense<[i: 100000, j: 8], {p: f32}>>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @p = @t["p"] : f32, rank 2

// CHECK-LABEL: tai.kernel @pairs
//       CHECK:   tai.parallel_for (%{{.+}}) = (%{{.+}}) to (%{{.+}}) {
//       CHECK:   tai.atomic add %{{.+}}, @x[%{{.+}}] exclusive
//       CHECK:   tai.atomic add %{{.+}}, @x[%{{.+}}] exclusive
//       CHECK:   tai.return
tai.kernel @pairs(%v: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %n = arith.constant 500000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.muli %i, %c2 : index
    %1 = arith.addi %0, %c1 : index
    %2 = tai.atomic add %v, @x[%0] : f32
    %3 = tai.atomic add %v, @x[%1] : f32
  }
  tai.return
}

// Planes that differ by a value from outside of the loop.
// CHECK-LABEL: tai.kernel @planes
//       CHECK:   tai.atomic add %{{.+}}, @p[%{{.+}}] exclusive
//       CHECK:   tai.atomic add %{{.+}}, @p[%{{.+}}] exclusive
//       CHECK:   tai.return
tai.kernel @planes(%v: f32, %t: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %n = arith.constant 100000 : index
  %next = arith.addi %t, %c1 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.atomic add %v, @p[%i, %t] : f32
    %1 = tai.atomic add %v, @p[%i, %next] : f32
  }
  tai.return
}

// An even number of places apart: iteration i + 1 reaches what i reaches.
// CHECK-LABEL: tai.kernel @overlapping
//   CHECK-NOT:   exclusive
//       CHECK:   tai.return
tai.kernel @overlapping(%v: f32) {
  %c0 = arith.constant 0 : index
  %c2 = arith.constant 2 : index
  %n = arith.constant 400000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.muli %i, %c2 : index
    %1 = arith.addi %0, %c2 : index
    %2 = tai.atomic add %v, @x[%0] : f32
    %3 = tai.atomic add %v, @x[%1] : f32
  }
  tai.return
}

// Neighbours, and a place that two iterations share.
// CHECK-LABEL: tai.kernel @neighbours
//   CHECK-NOT:   exclusive
//       CHECK:   tai.return
tai.kernel @neighbours(%v: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %n = arith.constant 400000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.addi %i, %c1 : index
    %1 = tai.atomic add %v, @x[%i] : f32
    %2 = tai.atomic add %v, @x[%0] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @halves
//   CHECK-NOT:   exclusive
//       CHECK:   tai.return
tai.kernel @halves(%v: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %n = arith.constant 400000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.divui %i, %c2 : index
    %1 = arith.muli %0, %c2 : index
    %2 = arith.addi %1, %c1 : index
    %3 = tai.atomic add %v, @x[%1] : f32
    %4 = tai.atomic add %v, @x[%2] : f32
  }
  tai.return
}
