// RUN: tai-opt %s --tai-scatter-to-gather | FileCheck %s
// RUN: tai-opt %s --tai-scatter-to-gather=on-device | FileCheck %s --check-prefix=DEVICE

// Additions that depend on values that the loop takes from the same field, in
// the place of which it stores zero: another iteration would find zero there,
// or not. The zeros are stored in a second loop, except where that is a second
// launch on a GPU.

!t = !tai.root<dense<[i: 2, j: 16], {g: f32}>, dense<[i: 2, j: 16], {h: f32}>>
tai.tree @t : !t
tai.field @g = @t["g"] : f32, rank 2
tai.field @h = @t["h"] : f32, rank 2

//  CHECK-LABEL: tai.kernel @takes
//        CHECK:   tai.parallel_for
//    CHECK-NOT:     tai.store
//        CHECK:     tai.load @g[%c1, %{{.+}}]
//        CHECK:     tai.atomic add %{{.+}}, @g[%c0, %{{.+}}] exclusive
//        CHECK:   tai.parallel_for (%[[J:.+]]) = (%c0) to (%c16)
//   CHECK-NEXT:     tai.store %{{.+}}, @g[%c1, %[[J]]]
//   CHECK-NEXT:   }
// DEVICE-LABEL: tai.kernel @takes
//       DEVICE:   tai.store
//  DEVICE-NEXT:   tai.atomic add
//  DEVICE-NEXT: }
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

// A condition is decided again, from what the loop does not write.
// CHECK-LABEL: tai.kernel @takes_where
//       CHECK:   tai.parallel_for
//       CHECK:     tai.atomic add %{{.+}}, @g[%c0, %{{.+}}] exclusive
//       CHECK:   tai.parallel_for
//       CHECK:     %[[TAKES:.+]] = arith.cmpi
//       CHECK:     scf.if %[[TAKES]] {
//       CHECK:       tai.store %{{.+}}, @g[%c1, %{{.+}}]
tai.kernel @takes_where() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c15 = arith.constant 15 : index
  %c16 = arith.constant 16 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%j) = (%c0) to (%c16) {
    %takes = arith.cmpi slt, %j, %c15 : index
    scf.if %takes {
      %k = arith.addi %j, %c1 : index
      %0 = tai.load @g[%c1, %j] : f32
      tai.store %zero, @g[%c1, %j] : f32
      tai.atomic add %0, @g[%c0, %k] : f32
    }
  }
  tai.return
}

// What is taken from @h has been added to before.
// CHECK-LABEL: tai.kernel @adds_before
//       CHECK:   tai.parallel_for
//   CHECK-NOT:     tai.atomic add %{{.+}}, @h
//       CHECK:     %[[H:.+]] = tai.load @h
//       CHECK:     arith.addf %[[H]]
//       CHECK:     tai.atomic add %{{.+}}, @g[%c0, %{{.+}}] exclusive
//       CHECK:   tai.parallel_for
//   CHECK-DAG:     tai.store %{{.+}}, @g[%c1, %{{.+}}]
//   CHECK-DAG:     tai.store %{{.+}}, @h[%c1, %{{.+}}]
tai.kernel @adds_before() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c16 = arith.constant 16 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%j) = (%c0) to (%c16) {
    %k = arith.addi %j, %c1 : index
    %0 = tai.load @g[%c1, %j] : f32
    tai.store %zero, @g[%c1, %j] : f32
    tai.atomic add %0, @h[%c1, %j] exclusive : f32
    %1 = tai.load @h[%c1, %j] : f32
    tai.store %zero, @h[%c1, %j] : f32
    tai.atomic add %1, @g[%c0, %k] : f32
  }
  tai.return
}

// The element that was stored to is read again.
// CHECK-LABEL: tai.kernel @reads_again
//       CHECK:   tai.store
//       CHECK:   tai.atomic add %{{.+}}, @g[%{{.+}}, %{{[^]]+}}] : f32
//   CHECK-NOT: tai.parallel_for
//       CHECK: tai.return
tai.kernel @reads_again() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c16 = arith.constant 16 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%j) = (%c0) to (%c16) {
    %k = arith.addi %j, %c1 : index
    %0 = tai.load @g[%c1, %j] : f32
    tai.store %zero, @g[%c1, %j] : f32
    %1 = tai.load @g[%c1, %j] : f32
    %2 = arith.addf %0, %1 : f32
    tai.atomic add %2, @g[%c0, %k] : f32
  }
  tai.return
}

// Another iteration stores something else.
// CHECK-LABEL: tai.kernel @stores_values
//       CHECK:   tai.store
//       CHECK:   tai.atomic add %{{.+}}, @g[%{{.+}}, %{{[^]]+}}] : f32
//   CHECK-NOT: tai.parallel_for
//       CHECK: tai.return
tai.kernel @stores_values() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c16 = arith.constant 16 : index
  tai.parallel_for (%j) = (%c0) to (%c16) {
    %k = arith.addi %j, %c1 : index
    %0 = tai.load @g[%c1, %j] : f32
    %1 = arith.addf %0, %0 : f32
    tai.store %1, @g[%c1, %j] : f32
    tai.atomic add %0, @g[%c0, %k] : f32
  }
  tai.return
}

// The condition of the store is written by the loop.
// CHECK-LABEL: tai.kernel @decides_by_data
//       CHECK:   tai.atomic add %{{.+}}, @g[%{{.+}}, %{{[^]]+}}] : f32
//   CHECK-NOT: tai.parallel_for
//       CHECK: tai.return
tai.kernel @decides_by_data() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c16 = arith.constant 16 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%j) = (%c0) to (%c16) {
    %k = arith.addi %j, %c1 : index
    %h = tai.load @h[%c0, %j] : f32
    %takes = arith.cmpf olt, %h, %zero : f32
    scf.if %takes {
      %0 = tai.load @g[%c1, %j] : f32
      tai.store %zero, @g[%c1, %j] : f32
      tai.store %0, @h[%c0, %j] : f32
      tai.atomic add %0, @g[%c0, %k] : f32
    }
  }
  tai.return
}

// DEVICE-LABEL: tai.kernel @deterministic
//       DEVICE:   tai.atomic add %{{.+}}, @g[%{{.+}}, %{{.+}}] exclusive
//       DEVICE:   tai.parallel_for
//       DEVICE:     tai.store
tai.kernel @deterministic() attributes {modes = {sums = "deterministic"}} {
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
