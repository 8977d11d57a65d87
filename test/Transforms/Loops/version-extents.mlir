// RUN: tai-opt %s --tai-version-extents | FileCheck %s
// RUN: tai-opt %s --tai-version-extents=max-ops=1 | FileCheck %s --check-prefix=SMALL

tai.tree @t : !tai.root<dense<[i: 64], {x: f32, y: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1

// The loop reaches the end of the fields for 64, where the bound is 63.
// CHECK-LABEL: tai.kernel @whole(
//  CHECK-SAME:     %[[M:.+]]: i32
//       CHECK:   %[[WHOLE:.+]] = arith.cmpi eq, %[[M]], %c64_i32
//       CHECK:   scf.if %[[WHOLE]] {
//       CHECK:     tai.parallel_for (%{{.+}}) = (%{{.+}}) to (%c63
//       CHECK:       arith.remsi %{{.+}}, %c64_i32
//       CHECK:   } else {
//       CHECK:     tai.parallel_for
//       CHECK:       arith.remsi %{{.+}}, %[[M]]
// SMALL-LABEL: tai.kernel @whole(
//   SMALL-NOT:   scf.if
tai.kernel @whole(%m: i32) {
  %c1 = arith.constant 1 : index
  %c1_i32 = arith.constant 1 : i32
  %last = arith.index_cast %m : i32 to index
  %end = arith.subi %last, %c1 : index
  tai.parallel_for (%i) = (%c1) to (%end) {
    %ahead = arith.addi %i, %c1 : index
    %0 = tai.load @y[%ahead] : f32
    %1 = arith.index_cast %i : index to i32
    %2 = arith.addi %1, %c1_i32 : i32
    %3 = arith.remsi %2, %m : i32
    %4 = arith.index_cast %3 : i32 to index
    %5 = tai.atomic add %0, @x[%4] : f32
  }
  tai.return
}

// Each iteration has its own elements: constants would not help.
// CHECK-LABEL: tai.kernel @own(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
tai.kernel @own(%m: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%m) {
    %0 = tai.load @y[%i] : f32
    %1 = tai.atomic add %0, @x[%i] : f32
  }
  tai.return
}

// The bound is a number of two arguments.
// CHECK-LABEL: tai.kernel @two(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
tai.kernel @two(%m: index, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %end = arith.subi %m, %n : index
  tai.parallel_for (%i) = (%c0) to (%end) {
    %0 = tai.load @y[%i] : f32
    %1 = arith.addi %i, %c1 : index
    %2 = tai.atomic add %0, @x[%1] : f32
  }
  tai.return
}

// No field says where the loop ends.
// CHECK-LABEL: tai.kernel @unbounded(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
tai.kernel @unbounded(%m: index, %v: f32) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%m) {
    %0 = arith.remsi %i, %m : index
    %1 = tai.atomic add %v, @x[%0] : f32
  }
  tai.return
}
