// RUN: tai-opt %s --tai-mark-exclusive | FileCheck %s

!t = !tai.root<dense<[i: 8, j: 16], {x: f32, y: f32, n: i32, v: vector<2xf32>}>, {loss: f32}>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 2
tai.field @y = @t["y"] : f32, rank 2
tai.field @v = @t["v"] : vector<2xf32>, rank 2
tai.field @n = @t["n"] : i32, rank 2
tai.field @loss = @t["loss"] : f32, rank 0

// Distinct iterations reach distinct elements, shifted or transposed, and also
// through several components; one element for all needs the atomic.
// CHECK-LABEL: tai.kernel @maps(
//       CHECK:   tai.atomic add %{{.+}}, @x[%{{.+}}, %{{.+}}] exclusive : f32
//       CHECK:   tai.atomic add %{{.+}}, @y[%{{.+}}, %{{.+}}] exclusive : f32
//       CHECK:   tai.atomic add %{{.+}}, @v{{.+}}{{.*}} exclusive : f32
//       CHECK:   tai.atomic add %{{.+}}, @v{{.+}}{{.*}} exclusive : f32
//       CHECK:   tai.atomic add %{{.+}}, @loss[] : f32
tai.kernel @maps(%a: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i, %j) in @x {
    tai.atomic add %a, @x[%i, %j] : f32
    %k = arith.subi %c1, %i : index
    %l = arith.addi %i, %j : index
    tai.atomic add %a, @y[%k, %l] : f32
    tai.atomic add %a, @v[%i, %j] component [%c0] : f32
    tai.atomic add %a, @v[%i, %j] component [%c1] : f32
    tai.atomic add %a, @loss[] : f32
  }
  tai.return
}

// Two writes of one field that do not agree may meet, also if one of them is a
// store.
// CHECK-LABEL: tai.kernel @disagree(
//   CHECK-NOT:   exclusive
//       CHECK:   tai.return
tai.kernel @disagree(%a: f32) {
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i, %j) in @x {
    %k = arith.addi %j, %c1 : index
    tai.atomic add %a, @x[%i, %j] : f32
    tai.atomic add %a, @x[%i, %k] : f32
    tai.atomic add %a, @y[%i, %j] : f32
    tai.store %a, @y[%i, %k] : f32
  }
  tai.return
}

// Where the indices that agree tell iterations apart, the others may differ.
// CHECK-LABEL: tai.kernel @rows(
//       CHECK:   @x[%{{.+}}, %{{.+}}] exclusive
//       CHECK:   @x[%{{.+}}, %{{.+}}] exclusive
tai.kernel @rows(%a: f32, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    tai.atomic add %a, @x[%i, %c0] : f32
    scf.for %j = %c0 to %n step %c1 {
      tai.atomic add %a, @x[%i, %j] : f32
    }
  }
  tai.return
}

// Indices that are read, or multiplied in 32 bits and so may wrap around, prove
// nothing. A mark that does not hold is taken away.
// CHECK-LABEL: tai.kernel @unproven(
//   CHECK-NOT:   exclusive
//       CHECK:   tai.return
tai.kernel @unproven(%a: f32, %n: index) {
  %c0 = arith.constant 0 : index
  %big = arith.constant 65536 : i32
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @n[%c0, %i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = arith.addi %1, %i : index
    tai.atomic add %a, @x[%c0, %2] exclusive : f32
    %3 = arith.index_cast %i : index to i32
    %4 = arith.muli %3, %big : i32
    %5 = arith.index_cast %4 : i32 to index
    tai.atomic add %a, @y[%c0, %5] : f32
  }
  tai.return
}

// One thread is alone: outside of parallel loops, and in a serialized one.
// CHECK-LABEL: tai.kernel @serial(
//       CHECK:   @loss[] exclusive
//       CHECK:   @loss[] exclusive
tai.kernel @serial(%a: f32, %n: index) {
  %c0 = arith.constant 0 : index
  tai.atomic add %a, @loss[] : f32
  tai.parallel_for (%i) = (%c0) to (%n) serialize {
    tai.atomic add %a, @loss[] : f32
  }
  tai.return
}

// Arithmetic in 8 or 16 bits comes around: iterations 0 and 256 meet. In 32
// bits, as indices usually are, it does not.
// CHECK-LABEL: tai.kernel @narrow(
//   CHECK-NOT:   exclusive
//       CHECK:   tai.return
tai.kernel @narrow(%a: f32, %n: index) {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1 : i8
  %one16 = arith.constant 1 : i16
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.index_cast %i : index to i8
    %1 = arith.addi %0, %one : i8
    %2 = arith.index_cast %1 : i8 to index
    tai.atomic add %a, @x[%c0, %2] : f32
    %3 = arith.index_cast %i : index to i16
    %4 = arith.subi %3, %one16 : i16
    %5 = arith.extsi %4 : i16 to i32
    %6 = arith.index_cast %5 : i32 to index
    tai.atomic add %a, @y[%c0, %6] : f32
  }
  tai.return
}

// Both digits of the index tell iterations apart, and one does not. They may be
// those of a number of the launch, as programs in Python divide.
// CHECK-LABEL: tai.kernel @digits(
//       CHECK:   @x[%{{.+}}, %{{.+}}] exclusive
//       CHECK:   @y[%{{.+}}, %{{.+}}] exclusive
//   CHECK-NOT:   exclusive
//       CHECK:   tai.return
tai.kernel @digits(%a: f32, %m: i32) {
  %c0 = arith.constant 0 : index
  %c4 = arith.constant 4 : index
  %c16 = arith.constant 16 : index
  %zero = arith.constant 0 : i32
  %one = arith.constant 1 : i32
  tai.parallel_for (%i) = (%c0) to (%c16) {
    %0 = arith.floordivsi %i, %c4 : index
    %1 = arith.remsi %i, %c4 : index
    tai.atomic add %a, @x[%0, %1] : f32
    %j = arith.index_cast %i : index to i32
    %rem = arith.remsi %j, %m : i32
    %ne = arith.cmpi ne, %rem, %zero : i32
    %bits = arith.xori %rem, %m : i32
    %slt = arith.cmpi slt, %bits, %zero : i32
    %wrong = arith.andi %ne, %slt : i1
    %up = arith.addi %rem, %m : i32
    %low = arith.select %wrong, %up, %rem : i32
    %div = arith.divsi %j, %m : i32
    %down = arith.subi %div, %one : i32
    %high = arith.select %wrong, %down, %div : i32
    %2 = arith.index_cast %high : i32 to index
    %3 = arith.index_cast %low : i32 to index
    tai.atomic add %a, @y[%2, %3] : f32
  }
  tai.parallel_for (%i) = (%c0) to (%c16) {
    %0 = arith.floordivsi %i, %c4 : index
    tai.atomic add %a, @x[%0, %c0] : f32
    %1 = arith.remsi %i, %c4 : index
    tai.atomic add %a, @y[%c0, %1] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @wide(
//       CHECK:   @x[%{{.+}}, %{{.+}}] exclusive
tai.kernel @wide(%a: f32, %n: index) {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1 : i32
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.index_cast %i : index to i32
    %1 = arith.addi %0, %one : i32
    %2 = arith.index_cast %1 : i32 to index
    tai.atomic add %a, @x[%c0, %2] : f32
  }
  tai.return
}
