// RUN: tai-opt %s --tai-make-adjoint=stored-outputs | FileCheck %s

// Which version of a field an adjoint reads: before the launch, after it, or what
// a second execution finds.

!t = !tai.root<dense<[i: 16], {x: f64, gx: f64, y: f64, gy: f64, n: i32}>, dense<[i: 4, j: 16], {z: f64, gz: f64}>>
tai.tree @t : !t
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @gy = @t["gy"] : f64, rank 1
tai.field @gz = @t["gz"] : f64, rank 2
tai.field @x = @t["x"] : f64, rank 1, adjoint @gx
tai.field @y = @t["y"] : f64, rank 1, adjoint @gy
tai.field @z = @t["z"] : f64, rank 2, adjoint @gz
tai.field @n = @t["n"] : i32, rank 1

// Two updates of one field need it as it was; so may a read of another row be.
// CHECK-LABEL: tai.kernel @two_rows_grad()
//  CHECK-SAME:   reads_before = [@z]
// CHECK-LABEL: tai.kernel @read_other_row_grad()
//  CHECK-SAME:   reads_before = [@z]
tai.kernel @two_rows() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    tai.atomic max %0, @z[%c0, %c0] : f64
    tai.atomic mul %0, @z[%c1, %c0] : f64
  }
  tai.return
}
tai.kernel @read_other_row() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = tai.load @z[%c2, %i] : f64
    %2 = arith.mulf %0, %1 : f64
    tai.atomic max %2, @z[%c0, %c0] : f64
  }
  tai.return
}

// What is stored cannot be loaded where the adjoint executes stores again, draws
// again, or reads the field as it was before.
// CHECK-LABEL: tai.kernel @stored_and_recorded_grad()
//  CHECK-SAME:   reads_before = [@x], reexecutes}
// CHECK-LABEL: tai.kernel @stored_over_needed_grad()
//  CHECK-SAME:   attributes {reads_before = [@x]}
// CHECK-LABEL: tai.kernel @drawn_and_stored_grad(
//   CHECK-NOT:   stored_form
//       CHECK:   tai.return
tai.kernel @stored_and_recorded() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = math.tanh %0 : f64
    tai.store %1, @y[%i] : f64
    %2 = math.sin %1 : f64
    tai.store %2, @x[%i] : f64
    %3 = tai.load @x[%i] : f64
    %4 = math.sin %3 : f64
    tai.store %4, @x[%i] : f64
  }
  tai.return
}
tai.kernel @stored_over_needed() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = math.tanh %0 : f64
    %2 = arith.mulf %1, %0 : f64
    tai.store %1, @x[%i] : f64
    tai.store %2, @y[%i] : f64
  }
  tai.return
}
tai.kernel @drawn_and_stored(%k: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    scf.for %j = %c0 to %k step %c1 {
      %u = tai.random stream 0 : f64
      %1 = arith.mulf %0, %u : f64
      tai.atomic add %1, @y[%i] : f64
    }
    %t = math.tanh %0 : f64
    tai.store %t, @z[%c0, %i] : f64
  }
  tai.return
}
