// RUN: tai-opt %s --allow-unregistered-dialect --tai-make-adjoint --verify-diagnostics

// Unknown ops make the carried values of a loop: each of them is refused once,
// however often the gradient asks for it.
func.func @carried(%x: memref<4xf64>, %y: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %one = arith.constant 1.0 : f64
  // expected-error @+1 {{the result of 'foo.make' is needed by the gradient and cannot be computed again}}
  %init = "foo.make"() : () -> !foo.bar
  %r:2 = scf.for %i = %c0 to %c4 step %c1 iter_args(%s = %init, %a = %one) -> (!foo.bar, f64) {
    %0 = memref.load %x[%i] : memref<4xf64>
    // expected-error @+1 {{the result of 'foo.get' is needed by the gradient and cannot be computed again}}
    %1 = "foo.get"(%s) : (!foo.bar) -> f64
    %2 = arith.mulf %a, %1 : f64
    %3 = arith.mulf %2, %0 : f64
    // expected-error @+1 {{the result of 'foo.step' is needed by the gradient and cannot be computed again}}
    %4 = "foo.step"(%s) : (!foo.bar) -> !foo.bar
    scf.yield %4, %3 : !foo.bar, f64
  }
  memref.store %r#1, %y[] : memref<f64>
  return
}
