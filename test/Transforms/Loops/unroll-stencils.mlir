// RUN: tai-opt %s --tai-unroll-stencils | FileCheck %s
// RUN: tai-opt %s --tai-unroll-stencils=max-trips=1 | FileCheck %s --check-prefix=FEW

tai.tree @t : !tai.root<dense<[i: 64], {x: f32}>, dense<[k: 4], {w: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @w = @t["w"] : f32, rank 1

// An index is the sum of both loop indices.
// CHECK-LABEL: tai.kernel @neighbours(
//   CHECK-NOT:   scf.for
//       CHECK:   tai.return
//   FEW-LABEL: tai.kernel @neighbours(
//         FEW:   scf.for
tai.kernel @neighbours(%v: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c60 = arith.constant 60 : index
  tai.parallel_for (%i) = (%c0) to (%c60) {
    scf.for %k = %c0 to %c3 step %c1 {
      %0 = arith.addi %i, %k : index
      %1 = tai.atomic add %v, @x[%0] : f32
    }
  }
  tai.return
}

// The loop of a matrix has no element that depends on both.
// CHECK-LABEL: tai.kernel @apart(
//       CHECK:   scf.for
//       CHECK:   tai.return
tai.kernel @apart() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c60 = arith.constant 60 : index
  tai.parallel_for (%i) = (%c0) to (%c60) {
    scf.for %k = %c0 to %c3 step %c1 {
      %0 = tai.load @w[%k] : f32
      %1 = tai.atomic add %0, @x[%i] : f32
    }
  }
  tai.return
}

// A number of rounds that only the launch knows.
// CHECK-LABEL: tai.kernel @unknown(
//       CHECK:   scf.for
//       CHECK:   tai.return
tai.kernel @unknown(%v: f32, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c60 = arith.constant 60 : index
  tai.parallel_for (%i) = (%c0) to (%c60) {
    scf.for %k = %c0 to %n step %c1 {
      %0 = arith.addi %i, %k : index
      %1 = tai.atomic add %v, @x[%0] : f32
    }
  }
  tai.return
}
