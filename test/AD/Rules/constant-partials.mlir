// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s

// Partial derivatives that are constants, and adjoints that may be no number.

tai.tree @t : !tai.root<dense<[i: 8], {x: vector<2xf64>, gx: vector<2xf64>, y: vector<2xf64>, gy: vector<2xf64>, a: f64, ga: f64, e: f64, ge: f64}>>
tai.field @x = @t["x"] : vector<2xf64>, rank 1, adjoint @gx
tai.field @gx = @t["gx"] : vector<2xf64>, rank 1
tai.field @y = @t["y"] : vector<2xf64>, rank 1, adjoint @gy
tai.field @gy = @t["gy"] : vector<2xf64>, rank 1
tai.field @a = @t["a"] : f64, rank 1, adjoint @ga
tai.field @ga = @t["ga"] : f64, rank 1
tai.field @e = @t["e"] : f64, rank 1, adjoint @ge
tai.field @ge = @t["ge"] : f64, rank 1

// A component of the partial is zero: its product with an infinite adjoint is
// dropped.
// CHECK-LABEL: tai.kernel @zero_component_grad()
//       CHECK:   arith.cmpf oeq, %[[C:.+]], %{{.+}} : vector<2xf64>
//       CHECK:   arith.select %{{.+}} {tai.guard_infinite}
tai.kernel @zero_component() {
  %c = arith.constant dense<[0.0, 2.0]> : vector<2xf64>
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : vector<2xf64>
    %1 = arith.mulf %0, %c : vector<2xf64>
    %2 = math.sqrt %1 : vector<2xf64>
    tai.store %2, @y[%i] : vector<2xf64>
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @no_zero_component_grad()
//   CHECK-NOT:   tai.guard_infinite
//       CHECK:   tai.return
tai.kernel @no_zero_component() {
  %c = arith.constant dense<[1.0, 2.0]> : vector<2xf64>
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : vector<2xf64>
    %1 = arith.mulf %0, %c : vector<2xf64>
    %2 = math.sqrt %1 : vector<2xf64>
    tai.store %2, @y[%i] : vector<2xf64>
  }
  tai.return
}

// The power of a negative number has no derivative by its exponent: NaN. The
// guards of ops before it look at the partial, and keep that NaN.
// CHECK-LABEL: tai.kernel @exponent_grad(
//       CHECK:   arith.cmpf uno
//       CHECK:   arith.cmpf ord
//       CHECK:   arith.select %{{.+}} {tai.guard_infinite}
tai.kernel @exponent(%b: f64) {
  tai.parallel_for (%i) in @e {
    %0 = tai.load @e[%i] : f64
    %2 = arith.mulf %0, %b : f64
    %1 = math.powf %b, %2 : f64
    tai.store %1, @a[%i] : f64
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @exponent_of_absolute_grad(
//   CHECK-NOT:   arith.cmpf uno
//       CHECK:   arith.select %{{.+}} {tai.guard_infinite}
tai.kernel @exponent_of_absolute(%b: f64) {
  %base = math.absf %b : f64
  tai.parallel_for (%i) in @e {
    %0 = tai.load @e[%i] : f64
    %2 = arith.mulf %0, %b : f64
    %1 = math.powf %base, %2 : f64
    tai.store %1, @a[%i] : f64
  }
  tai.return
}

// Only the signs of numbers of 16 bits are known: from -|x| - |x| follows that
// its negative is none below zero, but of x + x nothing is known.
tai.tree @h : !tai.root<dense<[i: 8], {hx: f16, hgx: f16, hy: f16, hgy: f16}>>
tai.field @hx = @h["hx"] : f16, rank 1, adjoint @hgx
tai.field @hgx = @h["hgx"] : f16, rank 1
tai.field @hy = @h["hy"] : f16, rank 1, adjoint @hgy
tai.field @hgy = @h["hgy"] : f16, rank 1

// CHECK-LABEL: tai.kernel @positive_grad(
//   CHECK-NOT:   arith.cmpf uno
//       CHECK:   tai.return
tai.kernel @positive(%e: f16) {
  tai.parallel_for (%i) in @hx {
    %0 = tai.load @hx[%i] : f16
    %1 = math.absf %0 : f16
    %m = arith.negf %1 : f16
    %2 = arith.addf %m, %m : f16
    %3 = arith.negf %2 : f16
    %e2 = arith.mulf %0, %e : f16
    %4 = math.powf %3, %e2 : f16
    tai.store %4, @hy[%i] : f16
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @any_grad(
//       CHECK:   arith.cmpf uno
//       CHECK:   tai.return
tai.kernel @any(%e: f16) {
  tai.parallel_for (%i) in @hx {
    %0 = tai.load @hx[%i] : f16
    %2 = arith.addf %0, %0 : f16
    %3 = arith.negf %2 : f16
    %e2 = arith.mulf %0, %e : f16
    %4 = math.powf %3, %e2 : f16
    tai.store %4, @hy[%i] : f16
  }
  tai.return
}
