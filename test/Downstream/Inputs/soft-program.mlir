// A program in the dialect of examples/dialect: the gradient of log(1 + exp(x)) at 1.

tai.tree @data : !tai.root<{x: f64, x_grad: f64, loss: f64, loss_grad: f64}>
tai.field @x_grad = @data["x_grad"] : f64, rank 0
tai.field @x = @data["x"] : f64, rank 0, adjoint @x_grad
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad

tai.kernel @soften() {
  %v = tai.load @x[] : f64
  %w = soft.plus %v : f64
  %old = tai.atomic add %w, @loss[] : f64
  tai.return
}

func.func @main() {
  %one = arith.constant 1.0 : f64
  tai.store %one, @x[] : f64
  tai.tape loss(@loss) {
    tai.launch @soften() : () -> ()
  }
  return
}
