// RUN: tai-opt %s --tai-version-interior --canonicalize | FileCheck %s
// RUN: tai-opt %s --tai-version-interior=min-length=65 --canonicalize | FileCheck %s --check-prefix=LONG

tai.tree @t : !tai.root<dense<[i: 8, j: 64], {x: f32, y: f32}>>
tai.field @x = @t["x"] : f32, rank 2
tai.field @y = @t["y"] : f32, rank 2

// The interior reads its neighbour without asking. The question about %i, which
// is not the innermost index, stays.
// CHECK-LABEL: tai.kernel @wrap(
//       CHECK:   tai.parallel_for (%[[I:.+]], %[[J:.+]]) in @x {
//       CHECK:     scf.if
//   CHECK-NOT:       arith.select %{{.+}}, %{{.+}}, %{{.+}} : index
//       CHECK:       tai.load @x[%[[I]], %{{.+}}]
//       CHECK:     } else {
//       CHECK:       arith.select
//       CHECK:       tai.load @x[%[[I]], %{{.+}}]
//       CHECK:     } {tai.interior = array<i64: 0, 63>}
// LONG-LABEL: tai.kernel @wrap(
//   LONG-NOT:   scf.if
tai.kernel @wrap() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c63 = arith.constant 63 : index
  tai.parallel_for (%i, %j) in @x {
    %up = arith.addi %j, %c1 : index
    %last = arith.cmpi eq, %j, %c63 : index
    %wrapped = arith.select %last, %c0, %up : index
    %0 = tai.load @x[%i, %wrapped] : f32
    tai.store %0, @y[%i, %j] : f32
  }
  tai.return
}

// No question, no second body.
// CHECK-LABEL: tai.kernel @plain(
//   CHECK-NOT:   scf.if
tai.kernel @plain() {
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : f32
    %1 = arith.cmpi ult, %i, %c4 : index
    %2 = arith.negf %0 : f32
    %3 = arith.select %1, %0, %2 : f32
    tai.store %3, @y[%i, %j] : f32
  }
  tai.return
}

// An answer that changes in the middle leaves no interior.
// CHECK-LABEL: tai.kernel @halves(
//   CHECK-NOT:   tai.interior
tai.kernel @halves() {
  %c32 = arith.constant 32 : index
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : f32
    %1 = arith.cmpi ult, %j, %c32 : index
    %2 = arith.negf %0 : f32
    %3 = arith.select %1, %0, %2 : f32
    tai.store %3, @y[%i, %j] : f32
  }
  tai.return
}

// A border that cuts indices off is a condition, too.
// CHECK-LABEL: tai.kernel @clamped(
//       CHECK:   scf.if
//       CHECK:   } else {
//       CHECK:     arith.cmpi slt
//       CHECK:     arith.select
//   CHECK-NOT:   arith.minsi
//       CHECK:   tai.return
tai.kernel @clamped() {
  %c1 = arith.constant 1 : index
  %c63 = arith.constant 63 : index
  tai.parallel_for (%i, %j) in @x {
    %up = arith.addi %j, %c1 : index
    %at = arith.minsi %up, %c63 : index
    %0 = tai.load @x[%i, %at] : f32
    tai.store %0, @y[%i, %j] : f32
  }
  tai.return
}
