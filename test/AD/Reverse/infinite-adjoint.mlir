// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s

tai.tree @t : !tai.root<dense<[i: 8], {x: f64, gx: f64, y: f64, gy: f64}>>
tai.field @x = @t["x"] : f64, rank 1, adjoint @gx
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @y = @t["y"] : f64, rank 1, adjoint @gy
tai.field @gy = @t["gy"] : f64, rank 1

// At zero the adjoint of the square is infinite and its derivative zero: the
// product is dropped, and not NaN. A derivative that is NaN itself is not.
// CHECK-LABEL: tai.kernel @root_of_square_grad
//       CHECK:   %[[X:.+]] = tai.load @x
//       CHECK:   %[[ZERO:.+]] = arith.cmpf oeq, %[[X]], %{{.+}} : f64
//       CHECK:   arith.select %[[ZERO]], %{{.+}}, %{{.+}} {tai.guard_infinite}
tai.kernel @root_of_square() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = arith.mulf %0, %0 : f64
    %2 = math.sqrt %1 : f64
    tai.store %2, @y[%i] : f64
  }
  tai.return
}

// Where nothing can be infinite, nothing asks.
// CHECK-LABEL: tai.kernel @polynomial_grad
//   CHECK-NOT:   math.absf
//   CHECK-NOT:   arith.cmpf
//       CHECK:   tai.return
tai.kernel @polynomial() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = arith.mulf %0, %0 : f64
    %2 = arith.addf %1, %0 : f64
    tai.store %2, @y[%i] : f64
  }
  tai.return
}

// A loop-carried value is infinite in all iterations if its result is. A factor
// that is zero takes nothing of it.
// CHECK-LABEL: tai.kernel @root_of_product_grad
//       CHECK:   scf.for
//       CHECK:     arith.select %{{.+}}, %{{.+}}, %{{.+}} {tai.guard_infinite}
//       CHECK:     arith.select %{{.+}}, %{{.+}}, %{{.+}} {tai.guard_infinite}
tai.kernel @root_of_product(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %one = arith.constant 1.0 : f64
  tai.parallel_for (%i) in @y {
    %all = scf.for %j = %c0 to %n step %c1 iter_args(%before = %one) -> f64 {
      %0 = tai.load @x[%j] : f64
      %1 = arith.mulf %before, %0 : f64
      scf.yield %1 : f64
    }
    %2 = math.sqrt %all : f64
    tai.store %2, @y[%i] : f64
  }
  tai.return
}

// A sum of quotients is not: the infinity is made inside of the iteration, and
// goes to none before it.
// CHECK-LABEL: tai.kernel @sum_of_quotients_grad
//   CHECK-NOT:   tai.guard_infinite
//       CHECK:   tai.return
tai.kernel @sum_of_quotients(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant 0.0 : f64
  tai.parallel_for (%i) in @y {
    %all = scf.for %j = %c0 to %n step %c1 iter_args(%before = %zero) -> f64 {
      %0 = tai.load @x[%j] : f64
      %1 = tai.load @x[%i] : f64
      %2 = arith.divf %0, %1 : f64
      %3 = arith.addf %before, %2 : f64
      scf.yield %3 : f64
    }
    tai.store %all, @y[%i] : f64
  }
  tai.return
}
