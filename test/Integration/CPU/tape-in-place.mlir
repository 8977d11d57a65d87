// RUN: tai-run %s --no-cache

// A state that is overwritten in place, under the tape of a host program.

tai.tree @t : !tai.root<dense<[i: 4], {x: f64, x_grad: f64}>>
tai.tree @s : !tai.root<{loss: f64, loss_grad: f64}>
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @loss_grad = @s["loss_grad"] : f64, rank 0
tai.field @loss = @s["loss"] : f64, rank 0, adjoint @loss_grad
tai.kernel @start() {
  %v = arith.constant 1.1 : f64
  tai.parallel_for (%i) in @x { tai.store %v, @x[%i] : f64 }
  tai.return
}
tai.kernel @square() {
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f64
    %p = arith.mulf %v, %v : f64
    tai.store %p, @x[%i] : f64
  }
  tai.return
}
tai.kernel @sum() {
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f64
    %old = tai.atomic add %v, @loss[] : f64
  }
  tai.return
}
func.func @main() {
  tai.launch @start() : () -> ()
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
    tai.launch @square() : () -> ()
    tai.launch @square() : () -> ()
    tai.launch @sum() : () -> ()
  }
  return
}
