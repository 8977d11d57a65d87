// RUN: tai-opt %s --tai-normalize-indices --canonicalize --cse | FileCheck %s

tai.tree @t : !tai.root<dense<[i: 8], {x: f32, y: f32, p: i32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @p = @t["p"] : i32, rank 1

// A remainder with the sign of the divisor, in 32 bits, becomes one select.
// CHECK-LABEL: tai.kernel @floor_modulo(
//   CHECK-DAG:   %[[C0:.+]] = arith.constant 0 : index
//   CHECK-DAG:   %[[CM1:.+]] = arith.constant -1 : index
//   CHECK-DAG:   %[[C7:.+]] = arith.constant 7 : index
//       CHECK:   tai.parallel_for (%[[I:.+]]) in @x {
//  CHECK-NEXT:     %[[MOVED:.+]] = arith.addi %[[I]], %[[CM1]] overflow<nsw> : index
//  CHECK-NEXT:     %[[OUT:.+]] = arith.cmpi slt, %[[MOVED]], %[[C0]] : index
//  CHECK-NEXT:     %[[WRAPPED:.+]] = arith.addi %[[I]], %[[C7]] overflow<nsw> : index
//  CHECK-NEXT:     %[[INDEX:.+]] = arith.select %[[OUT]], %[[WRAPPED]], %[[MOVED]] : index
//  CHECK-NEXT:     %[[X:.+]] = tai.load @x[%[[INDEX]]]
//  CHECK-NEXT:     tai.store %[[X]], @y[%[[I]]]
tai.kernel @floor_modulo() {
  %c1 = arith.constant 1 : i32
  %c8 = arith.constant 8 : i32
  tai.parallel_for (%i) in @x {
    %0 = arith.index_cast %i : index to i32
    %1 = arith.subi %0, %c1 : i32
    %2 = arith.floordivsi %1, %c8 : i32
    %3 = arith.muli %2, %c8 : i32
    %4 = arith.subi %1, %3 : i32
    %5 = arith.index_cast %4 : i32 to index
    %6 = tai.load @x[%5] : f32
    %7 = arith.index_cast %0 : i32 to index
    tai.store %6, @y[%7] : f32
  }
  tai.return
}

// Neither unknown bounds nor what memory holds can be evaluated.
// CHECK-LABEL: tai.kernel @stays(
//       CHECK:   arith.remsi
//       CHECK:   tai.load @p
//       CHECK:   arith.index_cast
//       CHECK:   tai.load @x
tai.kernel @stays(%n: index) {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.remsi %i, %c8 : index
    %1 = tai.load @p[%0] : i32
    %2 = arith.index_cast %1 : i32 to index
    %3 = tai.load @x[%2] : f32
    tai.store %3, @y[%0] : f32
  }
  tai.return
}
