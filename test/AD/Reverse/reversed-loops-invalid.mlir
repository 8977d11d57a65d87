// RUN: tai-opt %s --tai-make-adjoint --split-input-file --verify-diagnostics

// Loops that cannot run backwards, and loops that combine values more than once.

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad

// The cells of a field have no order that could be reversed.
tai.kernel @serialized_over_a_field() {
  // expected-error @+2 {{cannot reverse a serialized loop over a field}}
  // expected-note @+1 {{run it over a range, or use 'scf.for'}}
  tai.parallel_for (%i) in @x serialize {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    tai.store %1, @y[%i] : f32
  }
  tai.return
}

// Each run of the parallel loop finds what the one before it has left.
tai.kernel @combined_in_each_step() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  scf.for %k = %c0 to %c3 step %c1 {
    tai.parallel_for (%i) in @x {
      %0 = tai.load @x[%i] : f32
      // expected-error @+2 {{iterations combine values at the same time, in a loop that itself may run several times}}
      // expected-note @+1 {{give the parallel loop a kernel of its own}}
      tai.atomic max %0, @y[%c0] : f32
    }
  }
  tai.return
}

tai.kernel @combined_under_a_condition(%c: i1) {
  %c0 = arith.constant 0 : index
  scf.if %c {
    tai.parallel_for (%i) in @x {
      %0 = tai.load @x[%i] : f32
      // expected-error @+2 {{iterations combine values at the same time, in a loop that itself may run several times}}
      // expected-note @+1 {{give the parallel loop a kernel of its own}}
      tai.atomic mul %0, @y[%c0] : f32
    }
  }
  tai.return
}

// A loop that cannot be reversed is found in the condition of another one, and
// in its body.
tai.kernel @in_a_condition(%n: i32) {
  %c0 = arith.constant 0 : index
  %k0 = arith.constant 0 : i32
  %k1 = arith.constant 1 : i32
  %ten = arith.constant 10.0 : f32
  %0 = tai.load @x[%c0] : f32
  %r = scf.while (%a = %0) : (f32) -> f32 {
    // expected-error @+2 {{cannot reverse a loop with unsigned bounds}}
    // expected-note @+1 {{count in 'index', from zero to the number of iterations}}
    %s = scf.for unsigned %j = %k0 to %n step %k1 iter_args(%b = %a) -> (f32) : i32 {
      %t = math.sin %b : f32
      scf.yield %t : f32
    }
    %more = arith.cmpf olt, %s, %ten : f32
    scf.condition(%more) %s : f32
  } do {
  ^bb0(%p: f32):
    %q = arith.mulf %p, %p : f32
    scf.yield %q : f32
  }
  tai.store %r, @y[%c0] : f32
  tai.return
}

tai.kernel @in_a_body(%n: i32) {
  %c0 = arith.constant 0 : index
  %k0 = arith.constant 0 : i32
  %k1 = arith.constant 1 : i32
  %ten = arith.constant 10.0 : f32
  %0 = tai.load @x[%c0] : f32
  %r = scf.while (%a = %0) : (f32) -> f32 {
    %more = arith.cmpf olt, %a, %ten : f32
    scf.condition(%more) %a : f32
  } do {
  ^bb0(%p: f32):
    // expected-error @+2 {{cannot reverse a loop with unsigned bounds}}
    // expected-note @+1 {{count in 'index', from zero to the number of iterations}}
    %s = scf.for unsigned %j = %k0 to %n step %k1 iter_args(%b = %p) -> (f32) : i32 {
      %t = math.sin %b : f32
      scf.yield %t : f32
    }
    scf.yield %s : f32
  }
  tai.store %r, @y[%c0] : f32
  tai.return
}
