// A mass hangs on a spring: 100 steps of 0.02 s from a height of -1 m. The loss is the
// squared distance from a height of -2 m at the end. Programs in C, Python and Rust beside
// this file minimise it by the rest length.

tai.tree @data : !tai.root<{rest: f64, rest_grad: f64, loss: f64, loss_grad: f64}>
tai.field @rest_grad = @data["rest_grad"] : f64, rank 0
tai.field @rest = @data["rest"] : f64, rank 0, adjoint @rest_grad
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad

tai.kernel @swing() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %n = arith.constant 100 : index
  %h = arith.constant 0.02 : f64
  %k = arith.constant 20.0 : f64
  %g = arith.constant 9.81 : f64
  %goal = arith.constant -2.0 : f64
  %start = arith.constant -1.0 : f64
  %still = arith.constant 0.0 : f64
  %rest = tai.load @rest[] : f64
  %y, %v = scf.for %i = %c0 to %n step %c1
      iter_args(%y0 = %start, %v0 = %still) -> (f64, f64) {
    %stretch = arith.addf %y0, %rest : f64
    %force = arith.mulf %k, %stretch : f64
    %down = arith.addf %force, %g : f64
    %dv = arith.mulf %h, %down : f64
    %v1 = arith.subf %v0, %dv : f64
    %dy = arith.mulf %h, %v1 : f64
    %y1 = arith.addf %y0, %dy : f64
    scf.yield %y1, %v1 : f64, f64
  }
  %miss = arith.subf %y, %goal : f64
  %square = arith.mulf %miss, %miss : f64
  %old = tai.atomic add %square, @loss[] : f64
  tai.return
}

// One gradient, for `tai-run --print-field=@rest_grad` and for taiProgramRun.
func.func @main() {
  tai.tape loss(@loss) {
    tai.launch @swing() : () -> ()
  }
  return
}
