// RUN: tai-opt %s --split-input-file --tai-keep-order | FileCheck %s
// RUN: tai-opt %s --split-input-file --tai-keep-order --tai-relax-atomics | \
// RUN:   FileCheck %s --check-prefix=RELAX

!t = !tai.root<dense<[i: 64], {x: f32, y: f32}>, dense<[i: 64], {p: i32}>,
               dense<[i: 8, j: 8], {u: f32}>>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @p = @t["p"] : i32, rank 1
tai.field @u = @t["u"] : f32, rank 2

// Each iteration has its own element.
// CHECK-LABEL: tai.kernel @own(
//   CHECK-NOT:   in_order
// RELAX-LABEL: tai.kernel @own(
//       RELAX:   tai.independent
tai.kernel @own() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%i] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @before(
//       CHECK:   in_order
// RELAX-LABEL: tai.kernel @before(
//   RELAX-NOT:   tai.independent
//       RELAX:   in_order
tai.kernel @before() {
  %c1 = arith.constant 1 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c1) to (%c64) {
    %j = arith.subi %i, %c1 : index
    %0 = tai.load @x[%j] : f32
    tai.store %0, @x[%i] : f32
  }
  tai.return
}

// Odd elements follow from even ones.
// CHECK-LABEL: tai.kernel @parity(
//   CHECK-NOT:   in_order
tai.kernel @parity() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c32 = arith.constant 32 : index
  tai.parallel_for (%i) = (%c0) to (%c32) {
    %even = arith.muli %i, %c2 : index
    %odd = arith.addi %even, %c1 : index
    %0 = tai.load @x[%even] : f32
    tai.store %0, @x[%odd] : f32
  }
  tai.return
}

// The distance of the accesses is longer than the loop.
// CHECK-LABEL: tai.kernel @halves(
//   CHECK-NOT:   in_order
tai.kernel @halves() {
  %c0 = arith.constant 0 : index
  %c32 = arith.constant 32 : index
  tai.parallel_for (%i) = (%c0) to (%c32) {
    %j = arith.addi %i, %c32 : index
    %0 = tai.load @x[%i] : f32
    tai.store %0, @x[%j] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @scatter(
//       CHECK:   in_order
tai.kernel @scatter() {
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%j] : f32
  }
  tai.return
}

// All store the same, so that nobody can tell who was last.
// CHECK-LABEL: tai.kernel @clear(
//   CHECK-NOT:   in_order
tai.kernel @clear() {
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    tai.store %zero, @y[%j] : f32
  }
  tai.return
}

// Sums commute; a sum that somebody reads does not.
// CHECK-LABEL: tai.kernel @sums(
//   CHECK-NOT:   in_order
// CHECK-LABEL: tai.kernel @running_sums(
//       CHECK:   in_order
// CHECK-LABEL: tai.kernel @slots(
//       CHECK:   in_order
tai.kernel @sums() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.atomic add %0, @y[%c0] : f32
    tai.atomic sub %0, @y[%c0] : f32
  }
  tai.return
}
tai.kernel @running_sums() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.atomic add %0, @y[%c0] : f32
    %1 = tai.load @y[%c0] : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}
tai.kernel @slots() {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1 : i32
  tai.parallel_for (%i) in @x {
    %slot = tai.atomic add %one, @p[%c0] : i32
    %j = arith.index_cast %slot : i32 to index
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%j] : f32
  }
  tai.return
}

// Only one of the loop's indices tells iterations apart; then both.
// CHECK-LABEL: tai.kernel @rows(
//       CHECK:   in_order
// CHECK-LABEL: tai.kernel @flat(
//   CHECK-NOT:   in_order
tai.kernel @rows() {
  tai.parallel_for (%i, %j) in @u {
    %0 = tai.load @u[%i, %j] : f32
    tai.store %0, @x[%i] : f32
  }
  tai.return
}
tai.kernel @flat() {
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i, %j) in @u {
    %row = arith.muli %i, %c8 : index
    %at = arith.addi %row, %j : index
    %0 = tai.load @u[%i, %j] : f32
    tai.store %0, @x[%at] : f32
  }
  tai.return
}

// Arrays of the caller may be the same one.
// CHECK-LABEL: tai.kernel @arrays(
//       CHECK:   in_order
// CHECK-LABEL: tai.kernel @elements(
//   CHECK-NOT:   in_order
// CHECK-LABEL: tai.kernel @types(
//   CHECK-NOT:   in_order
tai.kernel @arrays(%a: memref<?xf32>, %b: memref<?xf32>) {
  %c1 = arith.constant 1 : index
  %c9 = arith.constant 9 : index
  tai.parallel_for (%i) = (%c1) to (%c9) {
    %j = arith.subi %i, %c1 : index
    %0 = memref.load %a[%j] : memref<?xf32>
    memref.store %0, %b[%i] : memref<?xf32>
  }
  tai.return
}
tai.kernel @elements(%a: memref<?xf32>, %b: memref<?xf32>) {
  %c1 = arith.constant 1 : index
  %c9 = arith.constant 9 : index
  tai.parallel_for (%i) = (%c1) to (%c9) {
    %0 = memref.load %a[%i] : memref<?xf32>
    memref.store %0, %b[%i] : memref<?xf32>
  }
  tai.return
}
tai.kernel @types(%a: memref<?xf32>, %b: memref<?xf64>) {
  %c1 = arith.constant 1 : index
  %c9 = arith.constant 9 : index
  tai.parallel_for (%i) = (%c1) to (%c9) {
    %j = arith.subi %i, %c1 : index
    %0 = memref.load %a[%j] : memref<?xf32>
    %1 = arith.extf %0 : f32 to f64
    memref.store %1, %b[%i] : memref<?xf64>
  }
  tai.return
}

// Of what others do to memory nothing is known.
// CHECK-LABEL: tai.kernel @unknown(
//       CHECK:   in_order
func.func private @other()
tai.kernel @unknown() {
  tai.parallel_for (%i) in @x {
    func.call @other() : () -> ()
  }
  tai.return
}

// Loops that are told to run in order do.
// CHECK-LABEL: tai.kernel @told(
//       CHECK:   serialize
//   CHECK-NOT:   in_order
tai.kernel @told() {
  tai.parallel_for (%i) in @x serialize {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%j] : f32
  }
  tai.return
}
