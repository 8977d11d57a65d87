// Iterations of large loops on a GPU get several neighbours each.
//
// RUN: tai-opt %s --tai-coarsen-threads=min-iterations=4096 --canonicalize --cse --split-input-file | FileCheck %s
// RUN: tai-opt %s --tai-coarsen-threads --split-input-file | FileCheck %s --check-prefix=SMALL

// SMALL-NOT: to (%{{.+}}, %{{.+}}, %{{.+}}, %{{.+}})

tai.tree @t : !tai.root<dense<[i: 64, j: 128], {x: f32}>, dense<[i: 64, j: 128], {y: f32}>>
tai.field @x = @t["x"] : f32, rank 2
tai.field @y = @t["y"] : f32, rank 2
tai.tree @s : !tai.root<dense<[i: 4096], {v: vector<2xf32>}>, dense<[i: 4099], {w: f64}>, {sum: f32}>
tai.field @v = @s["v"] : vector<2xf32>, rank 1
tai.field @w = @s["w"] : f64, rank 1
tai.field @sum = @s["sum"] : f32, rank 0
tai.tree @blocks : !tai.root<dense<[i: 16, j: 32], dense<[i: 4, j: 4], {b: f32}>>>
tai.field @b = @blocks["b"] : f32, rank 2

// Rows of four, which need no tiles: nobody reads another row.
// CHECK-LABEL: tai.kernel @copy(
//   CHECK-DAG:   %[[C0:.+]] = arith.constant 0 : index
//   CHECK-DAG:   %[[C4:.+]] = arith.constant 4 : index
//   CHECK-DAG:   %[[C64:.+]] = arith.constant 64 : index
//   CHECK-DAG:   %[[C32:.+]] = arith.constant 32 : index
//       CHECK:   tai.parallel_for (%[[I:.+]], %[[S:.+]]) = (%[[C0]], %[[C0]]) to (%[[C64]], %[[C32]]) {
//  CHECK-NEXT:     %[[J:.+]] = arith.muli %[[S]], %[[C4]]
//   CHECK-NOT:     scf
//       CHECK:     %[[A:.+]] = tai.load @x[%[[I]], %[[J]]]
//  CHECK-NEXT:     %[[B:.+]] = tai.load @x[%[[I]], %[[J1:.+]]]
//  CHECK-NEXT:     tai.load @x
//  CHECK-NEXT:     tai.load @x
//  CHECK-NEXT:     tai.store %[[A]], @y[%[[I]], %[[J]]]
//  CHECK-NEXT:     tai.store %[[B]], @y[%[[I]], %[[J1]]]
//  CHECK-NEXT:     tai.store
//  CHECK-NEXT:     tai.store
//  CHECK-NEXT:   }
tai.kernel @copy() {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  %c128 = arith.constant 128 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c64, %c128) {
    %0 = tai.load @x[%i, %j] : f32
    tai.store %0, @y[%i, %j] : f32
  }
  tai.return
}

// Tiles of 8 rows of 32 strips. Strips begin where vectors do; the question is
// asked once, and the border is a loop that stays one.
// CHECK-LABEL: tai.kernel @stencil(
//   CHECK-DAG:   %[[C0:.+]] = arith.constant 0 : index
//   CHECK-DAG:   %[[C1:.+]] = arith.constant 1 : index
//   CHECK-DAG:   %[[C8:.+]] = arith.constant 8 : index
//   CHECK-DAG:   %[[C32:.+]] = arith.constant 32 : index
//   CHECK-DAG:   %[[C4:.+]] = arith.constant 4 : index
//   CHECK-DAG:   %[[C62:.+]] = arith.constant 62 : index
//   CHECK-DAG:   %[[C123:.+]] = arith.constant 123 : index
//       CHECK:   tai.parallel_for (%[[TI:.+]], %[[TJ:.+]], %[[R:.+]], %[[S:.+]]) =
//  CHECK-SAME:       to (%[[C8]], %[[C1]], %[[C8]], %[[C32]]) {
//       CHECK:     %[[R8:.+]] = arith.muli %[[TI]], %[[C8]]
//       CHECK:     %[[I:.+]] = arith.addi %[[R8]], %[[R]]
//       CHECK:     %[[J:.+]] = arith.muli %{{.+}}, %[[C4]]
//       CHECK:     arith.cmpi ult, %{{.+}}, %[[C62]]
//       CHECK:     arith.cmpi ult, %{{.+}}, %[[C123]]
//       CHECK:     scf.if
//   CHECK-NOT:       scf.if
// CHECK-COUNT-4:     tai.load @x
// CHECK-COUNT-4:     tai.load @x
// CHECK-COUNT-4:     tai.store
//       CHECK:     } else {
//       CHECK:       scf.for
//       CHECK:         scf.if
//       CHECK:           tai.load @x
//       CHECK:           tai.load @x
//       CHECK:           tai.store
//       CHECK:       loop_annotation
tai.kernel @stencil() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c63 = arith.constant 63 : index
  %c64 = arith.constant 64 : index
  %c127 = arith.constant 127 : index
  %c128 = arith.constant 128 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c64, %c128) {
    %a = arith.cmpi sge, %i, %c1 : index
    %b = arith.cmpi slt, %i, %c63 : index
    %c = arith.cmpi sge, %j, %c1 : index
    %d = arith.cmpi slt, %j, %c127 : index
    %ab = arith.andi %a, %b : i1
    %cd = arith.andi %c, %d : i1
    %inside = arith.andi %ab, %cd : i1
    scf.if %inside {
      %up = arith.subi %i, %c1 : index
      %0 = tai.load @x[%up, %j] : f32
      %right = arith.addi %j, %c1 : index
      %1 = tai.load @x[%i, %right] : f32
      %2 = arith.addf %0, %1 : f32
      tai.store %2, @y[%i, %j] : f32
    }
  }
  tai.return
}

// A loop from 1 on: the first strip has three elements.
// CHECK-LABEL: tai.kernel @shifted(
//       CHECK:   tai.parallel_for (%{{.+}}, %[[S:.+]]) =
//       CHECK:     %[[J:.+]] = arith.muli %[[S]], %c4
//       CHECK:     arith.subi %[[J]], %c1
//       CHECK:     scf.if
//       CHECK:     } else {
//       CHECK:       arith.maxsi %[[J]], %c1
//       CHECK:       arith.minsi
//       CHECK:       scf.for
tai.kernel @shifted() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c64 = arith.constant 64 : index
  %c127 = arith.constant 127 : index
  tai.parallel_for (%i, %j) = (%c0, %c1) to (%c64, %c127) {
    %0 = tai.load @x[%i, %j] : f32
    tai.store %0, @y[%i, %j] : f32
  }
  tai.return
}

// Eight bytes: two of them, of both components. Sums in registers go along, and
// conditions on data stay.
// CHECK-LABEL: tai.kernel @vectors(
//       CHECK:   tai.parallel_for (%[[S:.+]]) = (%c0) to (%c2048) {
// CHECK-COUNT-2:   tai.load @v[%{{.+}}] component[%c0]
// CHECK-COUNT-2:   scf.if
//       CHECK:   tai.kernel @rest(
tai.kernel @vectors() {
  %c0 = arith.constant 0 : index
  %c4096 = arith.constant 4096 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) = (%c0) to (%c4096) {
    %0 = tai.load @v[%i] component [%c0] : f32
    %isLess = arith.cmpf olt, %0, %zero : f32
    scf.if %isLess {
      %1 = tai.atomic add %0, @sum[] reduction <register own any> : f32
    }
    tai.store %zero, @v[%i] component [%c0] : f32
  }
  tai.return
}

// An odd number of elements.
//       CHECK:   tai.parallel_for (%{{.+}}) = (%c0) to (%c2050) {
//       CHECK:     scf.if
//       CHECK:     } else {
tai.kernel @rest() {
  %c0 = arith.constant 0 : index
  %c4099 = arith.constant 4099 : index
  %zero = arith.constant 0.0 : f64
  tai.parallel_for (%i) = (%c0) to (%c4099) {
    %0 = tai.atomic add %zero, @w[%i] exclusive : f64
  }
  tai.return
}

// Clamped indices are those of neighbours inside.
// CHECK-LABEL: tai.kernel @clamped(
//       CHECK:   scf.if
//   CHECK-NOT:     arith.m
//  Two of the eight are the same.
// CHECK-COUNT-6:   tai.load @x
// CHECK-COUNT-4:   tai.store
//       CHECK:   } else {
//       CHECK:     arith.maxsi
//       CHECK:     arith.minsi
tai.kernel @clamped() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c64 = arith.constant 64 : index
  %c127 = arith.constant 127 : index
  %c128 = arith.constant 128 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c64, %c128) {
    %before = arith.subi %j, %c1 : index
    %left = arith.maxsi %before, %c0 : index
    %0 = tai.load @x[%i, %left] : f32
    %after = arith.addi %j, %c1 : index
    %right = arith.minsi %c127, %after : index
    %1 = tai.load @x[%i, %right] : f32
    %2 = arith.addf %0, %1 : f32
    tai.store %2, @y[%i, %j] : f32
  }
  tai.return
}

// Left alone: elements apart in memory,
// CHECK-LABEL: tai.kernel @columns(
//       CHECK:   tai.parallel_for (%{{.+}}, %{{.+}}) = (%c0, %c0) to (%c128, %c64) {
tai.kernel @columns(%f: f32) {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  %c128 = arith.constant 128 : index
  tai.parallel_for (%j, %i) = (%c0, %c0) to (%c128, %c64) {
    tai.store %f, @y[%i, %j] : f32
  }
  tai.return
}

// in blocks,
// CHECK-LABEL: tai.kernel @in_blocks(
//       CHECK:   tai.parallel_for (%{{.+}}, %{{.+}}) = (%c0, %c0) to (%c64, %c128) {
tai.kernel @in_blocks(%f: f32) {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  %c128 = arith.constant 128 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c64, %c128) {
    tai.store %f, @b[%i, %j] : f32
  }
  tai.return
}

// updates that others may meet,
// CHECK-LABEL: tai.kernel @scatter(
//       CHECK:   tai.parallel_for (%{{.+}}, %{{.+}}) = (%c0, %c0) to (%c64, %c128) {
tai.kernel @scatter(%k: index) {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  %c128 = arith.constant 128 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c64, %c128) {
    %0 = tai.load @x[%i, %j] : f32
    %1 = tai.atomic add %0, @y[%i, %k] : f32
    tai.store %0, @x[%i, %j] : f32
  }
  tai.return
}

// loops inside,
// CHECK-LABEL: tai.kernel @inner_loop(
//       CHECK:   tai.parallel_for (%{{.+}}, %{{.+}}) = (%c0, %c0) to (%c64, %c128) {
tai.kernel @inner_loop() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c64 = arith.constant 64 : index
  %c128 = arith.constant 128 : index
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c64, %c128) {
    %0 = scf.for %k = %c0 to %j step %c1 iter_args(%sum = %one) -> (f32) {
      %1 = tai.load @x[%i, %k] : f32
      %2 = arith.addf %sum, %1 : f32
      scf.yield %2 : f32
    }
    tai.store %0, @y[%i, %j] : f32
  }
  tai.return
}

// random numbers, which belong to the number of an iteration,
// CHECK-LABEL: tai.kernel @random(
//       CHECK:   tai.parallel_for (%{{.+}}, %{{.+}}) = (%c0, %c0) to (%c64, %c128) {
tai.kernel @random() {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  %c128 = arith.constant 128 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c64, %c128) {
    %0 = tai.random stream 0 : f32
    tai.store %0, @y[%i, %j] : f32
  }
  tai.return
}

// and loops whose length only the device knows.
// CHECK-LABEL: tai.kernel @unknown(
//       CHECK:   tai.parallel_for (%{{.+}}, %{{.+}}) = (%c0, %c0) to (%{{.+}}, %c128) {
tai.kernel @unknown(%n: index, %f: f32) {
  %c0 = arith.constant 0 : index
  %c128 = arith.constant 128 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%n, %c128) {
    tai.store %f, @y[%i, %j] : f32
  }
  tai.return
}
