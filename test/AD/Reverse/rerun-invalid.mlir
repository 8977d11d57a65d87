// RUN: tai-opt %s --tai-make-adjoint --allow-unregistered-dialect --verify-diagnostics

// What must not run twice is refused where an iteration would be run again.

!t = !tai.root<dense<[i: 16], {x: f64, gx: f64, y: f64, gy: f64, n: i32, c: i32}>, {a: f64, ga: f64}>
tai.tree @t : !t
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @gy = @t["gy"] : f64, rank 1
tai.field @ga = @t["ga"] : f64, rank 0
tai.field @x = @t["x"] : f64, rank 1, adjoint @gx
tai.field @y = @t["y"] : f64, rank 1, adjoint @gy
tai.field @a = @t["a"] : f64, rank 0, adjoint @ga
tai.field @n = @t["n"] : i32, rank 1
tai.field @c = @t["c"] : i32, rank 1
tai.kernel @slot() {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1 : i32
  tai.parallel_for (%i) in @x {
    // expected-error @+2 {{the value before the update is needed by the gradient, but is gone when the gradient runs}}
    // expected-note @+1 {{store it to a field that nothing else writes}}
    %s = tai.atomic add %one, @c[%c0] : i32
    %j = arith.sitofp %s : i32 to f64
    %0 = tai.load @x[%i] : f64
    %1 = math.sin %0 : f64
    %2 = arith.addf %1, %j : f64
    tai.store %2, @x[%i] : f64
    %3 = tai.load @x[%i] : f64
    %5 = math.sin %3 : f64
    tai.store %5, @x[%i] : f64
  }
  tai.return
}
tai.kernel @foreign() {
  tai.parallel_for (%i) in @x {
    // expected-error @+1 {{the result of 'foo.make' is needed by the gradient and cannot be computed again}}
    %j = "foo.make"() : () -> f64
    %0 = tai.load @x[%i] : f64
    %1 = math.sin %0 : f64
    %2 = arith.addf %1, %j : f64
    tai.store %2, @x[%i] : f64
    %3 = tai.load @x[%i] : f64
    %5 = math.sin %3 : f64
    tai.store %5, @x[%i] : f64
  }
  tai.return
}
