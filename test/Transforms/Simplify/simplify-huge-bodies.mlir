// RUN: tai-opt %s --pass-pipeline="builtin.module(tai-simplify-huge-bodies{min-ops=10})" \
// RUN:   | FileCheck %s
// RUN: tai-opt %s --tai-simplify-huge-bodies | FileCheck %s --check-prefix=SMALL

!t = !tai.root<dense<[i: 16], {x: f32, y: f32}>>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1

// Equal values, and reads with no write between them, are one; ops that a
// pattern can simplify are simplified; changed elements are read again.
// CHECK-LABEL: tai.kernel @huge
//       CHECK: tai.parallel_for (%[[I:.+]]) =
//  CHECK-NEXT:   %[[A:.+]] = tai.load @x[%[[I]]]
//  CHECK-NEXT:   %[[S:.+]] = arith.addf %[[A]], %[[A]]
//  CHECK-NEXT:   %[[M:.+]] = arith.mulf %[[S]], %[[S]]
//  CHECK-NEXT:   tai.store %[[M]], @x[%[[I]]]
//  CHECK-NEXT:   %[[B:.+]] = tai.load @x[%[[I]]]
//  CHECK-NEXT:   tai.store %[[B]], @y[%[[I]]]
//  CHECK-NEXT: }
// SMALL-LABEL: tai.kernel @huge
//       SMALL:   arith.select
tai.kernel @huge() {
  %c0 = arith.constant 0 : index
  %c16 = arith.constant 16 : index
  %true = arith.constant true
  tai.parallel_for (%i) = (%c0) to (%c16) {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @x[%i] : f32
    %2 = arith.addf %0, %1 : f32
    %3 = arith.addf %1, %0 : f32
    %4 = arith.addf %0, %0 : f32
    %5 = arith.select %true, %2, %1 : f32
    %6 = arith.mulf %4, %5 : f32
    tai.store %6, @x[%i] : f32
    %7 = tai.load @x[%i] : f32
    tai.store %7, @y[%i] : f32
  }
  tai.return
}

// A smaller body stays as it is, be it in the same kernel.
// CHECK-LABEL: tai.kernel @small
// CHECK-COUNT-2: tai.load
//       CHECK:   arith.addf
tai.kernel @small() {
  %c0 = arith.constant 0 : index
  %c16 = arith.constant 16 : index
  tai.parallel_for (%i) = (%c0) to (%c16) {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @x[%i] : f32
    %2 = arith.addf %0, %1 : f32
    tai.store %2, @y[%i] : f32
  }
  tai.return
}
