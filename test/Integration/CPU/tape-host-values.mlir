// RUN: tai-run %s --no-cache
// RUN: tai-run %s --no-cache --opt-level=0

// These may go through the host under a tape: numbers that no field with an
// adjoint stands behind, numbers that are read before it, numbers that are said
// to be constants, and stores of the host that no launch has seen yet.
tai.tree @t : !tai.root<{x: f64, gx: f64, loss: f64, gl: f64, c: f64}>
tai.field @gx = @t["gx"] : f64, rank 0
tai.field @gl = @t["gl"] : f64, rank 0
tai.field @x = @t["x"] : f64, rank 0, adjoint @gx
tai.field @loss = @t["loss"] : f64, rank 0, adjoint @gl
tai.field @c = @t["c"] : f64, rank 0
tai.kernel @constant() -> f64 {
  %0 = tai.load @c[] : f64
  tai.return %0 : f64
}
tai.kernel @read() -> f64 {
  %0 = tai.load @x[] : f64
  tai.return %0 : f64
}
tai.kernel @add(%s: f64) {
  %0 = tai.load @x[] : f64
  %1 = arith.mulf %0, %s : f64
  %2 = tai.atomic add %1, @loss[] : f64
  tai.return
}
func.func @main() {
  %zero = arith.constant 0.0 : f64
  %three = arith.constant 3.0 : f64
  %seven = arith.constant 7.0 : f64
  tai.store %three, @x[] : f64
  tai.store %seven, @c[] : f64
  %before = tai.load @x[] : f64
  tai.tape loss(@loss) {
    tai.store %zero, @loss[] : f64
    %k = tai.launch @constant() : () -> f64
    tai.launch @add(%k) : (f64) -> ()
    tai.launch @add(%before) : (f64) -> ()
    %r = tai.launch @read() : () -> f64
    %s = tai.stop_gradient %r : f64
    tai.launch @add(%s) : (f64) -> ()
  }
  // 7 x + 3 x + 3 x, the last two factors constant.
  %g = tai.load @gx[] : f64
  %thirteen = arith.constant 13.0 : f64
  tai_check.close %g, %thirteen tolerance 1.0e-15 : f64
  %l = tai.load @loss[] : f64
  %value = arith.constant 39.0 : f64
  tai_check.close %l, %value tolerance 1.0e-15 : f64
  return
}
